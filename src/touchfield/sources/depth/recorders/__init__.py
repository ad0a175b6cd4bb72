"""Depth sequences as today's cameras, phones and robots record them: one module for each layout."""
