"""Scenes from point clouds: reads their files, reduces the points to cells, and computes signed distances."""
