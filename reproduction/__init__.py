"""Reproduces the paper's tables and figures, each by a small script that uses the library: `python -m
reproduction`."""
