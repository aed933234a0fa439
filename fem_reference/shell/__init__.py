"""One part as a finite-element shell: elements, stiffness, factorisation, influence coefficients."""
