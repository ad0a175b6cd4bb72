"""Height maps as scenes."""
