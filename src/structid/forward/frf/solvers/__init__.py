"""Solvers of the equations of motion at the lines of a record: dense, sparse, tabulated and coupled."""
