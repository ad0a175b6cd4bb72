"""A file as a medium: its records, its coder and its frames, opened together."""
