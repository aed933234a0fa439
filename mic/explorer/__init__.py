"""Interactive page of ``mic explore``: a local server for one user (trame); the browser draws (vtk.js).

:mod:`mic.studies.exploration` computes the assemblies and is independent of the page.
"""
