"""Checks the index of an MCAP file before its messages are read."""

from __future__ import annotations

from typing import Any

from touchfield.errors import SourceError


def require_distinct_chunks(summary: Any, where: str) -> None:
    """Raise `SourceError` if the index of a file names a chunk more than once.

    `summary` is that of the library mcap; None for a file without an index. Each entry is decompressed and
    read again for every message that is requested, so that a small file could take hours.
    """
    starts = [entry.chunk_start_offset for entry in summary.chunk_indexes] if summary is not None else []
    if len(set(starts)) < len(starts):
        found = f"an index of {len(starts)} entries for {len(set(starts))} chunks"
        raise SourceError(where, found, "one entry for each chunk", "Write the index anew: mcap recover.")
