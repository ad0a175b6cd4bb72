"""Scenes from height maps, such as terrain."""
