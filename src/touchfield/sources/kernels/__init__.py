"""Compiled loops of the sources; each module imports numba, so import them inside functions."""
