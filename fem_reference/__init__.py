"""The truth: shell finite elements in dolfinx and PETSc, influence coefficients, full frictional contact."""

import mic  # noqa: F401  which chooses OpenBLAS's kernels before numpy loads it
