"""Analytic shapes as scenes."""
