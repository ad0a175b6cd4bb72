"""Frozen references: loops that kernels are timed against, and former figures."""
