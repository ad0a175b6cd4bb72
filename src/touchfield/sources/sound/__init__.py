"""The sound of movies: its samples, and where it is low or starts."""
