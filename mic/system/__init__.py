"""Files that survive a crash, the disk cache, locks, BLAS and compilation: everything that knows nothing of assemblies."""
