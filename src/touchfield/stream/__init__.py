"""Streams: a file as a medium, at home or from a server; live, with loss, and beside sound and picture."""
