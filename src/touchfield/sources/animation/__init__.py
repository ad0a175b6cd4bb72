"""Animated models as scenes: a mesh whose vertices move."""
