"""Scenes from depth images: data sets, live cameras, fusion into one world, and division into objects."""
