"""Compiled kernels of the measures; imported only when first needed, because they import numba."""
