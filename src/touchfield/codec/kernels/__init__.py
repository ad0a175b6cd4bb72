"""Compiled loops of the codec; imported inside functions, never with the package."""
