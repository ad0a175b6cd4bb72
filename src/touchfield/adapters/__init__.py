"""Devices and formats at the edge: one file for each, imported when it is asked for."""
