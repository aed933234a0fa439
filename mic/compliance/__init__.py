"""How parts yield: retained functionals, influence coefficients, who provides them, and their elimination in a stage."""
