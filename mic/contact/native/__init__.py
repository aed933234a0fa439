"""The native backend: compiled kernels, the rungs of the ladder, path following."""

from mic.system.compilation import announce_compilation

announce_compilation()
