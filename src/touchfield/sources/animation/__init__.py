"""Scenes from animated 3-D models: meshes whose vertices move."""
