"""Reads and writes ``.touch`` files as a sequence of records (head, segments, index, end), without decoding
the segments within.

The table in `records` defines the records; docs/format/container.md describes the bytes.
"""

from touchfield.container.reader import TouchReader
from touchfield.container.records import Head, ObjectRecord, SegmentEntry
from touchfield.container.writer import TouchWriter

__all__ = ["Head", "ObjectRecord", "SegmentEntry", "TouchReader", "TouchWriter"]
