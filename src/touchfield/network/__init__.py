"""Sends and receives streams over the network: files from a server, live streams, and movies with a track of
touch."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
