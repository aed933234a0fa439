"""Infrastructure: atomic files, disk cache, locks, BLAS kernels, compilation, console text."""
