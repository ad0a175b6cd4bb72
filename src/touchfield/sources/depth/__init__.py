"""Depth sequences as scenes: layouts, cameras, fusion, objects and live capture."""
