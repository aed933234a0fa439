"""Sampling designs, estimators with confidence intervals, capability indices, Sobol indices and the emulator."""
