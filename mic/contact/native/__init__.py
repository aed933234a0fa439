"""The native backend: compiled kernels, the cheap rungs, the patient rungs."""

from mic.system.compilation import announce_compilation

announce_compilation()
