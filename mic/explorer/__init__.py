"""The page on which an assembly is moved and looked at: local, for one user, with trame; drawn by the browser (vtk.js).

What answers a move is :mod:`mic.studies.exploration`, which knows nothing of pages.
"""
