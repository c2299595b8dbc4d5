"""How the equations of a model are solved at its lines: small, medium and large models, what joins them, solvers."""
