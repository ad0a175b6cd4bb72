"""Compiled code of the renderer. Imported only when first needed, because it imports numba."""
