"""Verification: error of the results of the reduced model, where it occurs, and what accuracy costs."""
