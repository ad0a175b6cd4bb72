"""Sources from recordings: forces that a probe met, and accelerations of a tool that slid along a surface."""
