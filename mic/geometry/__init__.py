"""The shape of parts and fixtures: meshes read, repaired and generated; surfaces; where two of them face each other."""
