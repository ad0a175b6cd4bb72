"""Compiled code of the adapters. Imported only when first needed, because it imports numba."""
