"""One part as a finite-element shell: elements, stiffness, factorisation, influence coefficients."""

from mpi4py import MPI  # noqa: F401  before dolfinx and petsc4py, whose wheels rely on the MPI library that it loads
