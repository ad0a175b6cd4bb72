"""Pictures and movies from files."""
