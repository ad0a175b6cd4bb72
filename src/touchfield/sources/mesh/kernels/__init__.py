"""Compiled loops over triangles: distance, winding number, forces."""
