"""Scenes of simple shapes whose distance has a formula, such as balls and boxes."""
