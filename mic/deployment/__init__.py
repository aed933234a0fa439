"""The model in the production line: the service of ``mic serve`` with its log, and the FMI unit of ``mic export``."""
