"""Compiled kernels of the filters; imported only when first needed, because they import numba."""
