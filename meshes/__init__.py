"""Geometries and scenes: one folder each, with a ``geometry`` module that builds its meshes.

Every ``geometry`` module offers ``PARTS`` (the names of its parts), ``SIZES`` (named resolutions in mm) and
``build(part, size) -> (points, triangles)``: the mid-surface of one sheet, points (n, 3) in mm and triangles (k, 3).
"""
