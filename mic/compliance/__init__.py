"""How parts yield: what is retained of them, influence coefficients, who provides them, how a fixture takes hold."""
