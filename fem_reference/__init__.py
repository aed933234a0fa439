"""The truth: shell finite elements in dolfinx and PETSc, influence coefficients, full frictional contact."""
