"""Compiled inner loops of the filters. Imported only when first needed, because they import numba."""
