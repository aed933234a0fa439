"""The Monte Carlo: distributions, independent streams, samples shared out in blocks."""
