"""The process: what each stage does, and the assembly's state on its way through them."""
