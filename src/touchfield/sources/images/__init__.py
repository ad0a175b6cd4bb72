"""Reads pictures and movies from files as arrays."""
