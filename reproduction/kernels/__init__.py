"""Compiled inner loops of the experiments."""
