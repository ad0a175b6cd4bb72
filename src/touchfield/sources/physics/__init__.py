"""Scenes of rigid bodies in motion: reads TOML files and MuJoCo models, and simulates them."""
