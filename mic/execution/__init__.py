"""The Monte Carlo loop: blocks of samples, shared out over MPI ranks and worker processes."""
