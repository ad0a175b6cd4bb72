"""Depth sequences as scenes: folder layouts, cameras, fusion of frames, objects, and live capture."""
