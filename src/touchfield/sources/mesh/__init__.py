"""Scenes from triangle meshes: reads their files, repairs their surfaces, and computes signed distances."""
