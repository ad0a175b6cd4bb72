"""Frozen references: loops that the time of kernels is compared with, and former figures."""
