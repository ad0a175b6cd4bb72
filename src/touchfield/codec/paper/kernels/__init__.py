"""Compiled loops of the paper's coder."""
