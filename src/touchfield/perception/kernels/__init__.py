"""Compiled kernels of perception; imported only when first needed, because they import numba."""
