"""Compiled inner loops over triangles: distance, inside or outside, and forces."""
