"""Element matrices of a structure: as values, with what weighs them, and on one sparsity pattern."""
