"""A scene put on its meshes: rows over retained functionals, sources of deviation, the reduced model."""
