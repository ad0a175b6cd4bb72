"""Streams over the network: files from a server, live with loss, and beside sound and picture."""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
