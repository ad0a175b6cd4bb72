"""Streams over the network: served files, live streams, and movies with touch."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
