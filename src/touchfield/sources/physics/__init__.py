"""Rigid bodies in motion: TOML files, MuJoCo models, and their simulation."""
