"""Compiled inner loops of point clouds."""
