"""Recordings: contacts of a probe, and accelerations of a tool."""
