"""The native backend: compiled kernels, the cheap rungs, the patient rungs."""

from mic.compiling import tell

tell()
