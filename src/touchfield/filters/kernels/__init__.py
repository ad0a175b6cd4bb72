"""Compiled inner loops of the filters. Imported only when first needed, because they import numba."""

# first, since its error names the extra if numba is missing
import touchfield.compute.jit  # noqa: F401
