"""Reads glTF 2.0 files: the document, and the animated model in it."""
