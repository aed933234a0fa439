"""The native backend: compiled kernels, the cheap rungs, the patient rungs."""
