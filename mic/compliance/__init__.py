"""Compliance of the parts: retained functionals, influence coefficients, their providers, and eliminated fixtures."""
