"""Compiled kernels of the streaming reduction; imported only where numba is wanted."""
