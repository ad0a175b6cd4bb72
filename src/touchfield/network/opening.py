"""Opens a stream from a path, a web address, or a live sender, whichever the user gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from touchfield.container.remote import is_live
from touchfield.errors import InvalidArgument
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.stream import OpenStream


@contextmanager
def open_stream(
    path: str | Path, on_note: Callable[[str], None] = lambda note: None, coarse: str | None = None
) -> Iterator[OpenStream]:
    """Open a ``.touch`` file, by its path or address, or a live stream.

    Decoding needs no configuration.

    `on_note` is called with notes on the losses of a live stream; `coarse` is the address of its coarse
    layer, which replaces lost or late segments.
    """
    if isinstance(path, str) and is_live(path):
        from touchfield.network.live_client import open_live  # slow to import

        with open_live(path, on_note, coarse) as live:
            yield live
        return
    if coarse is not None:
        raise InvalidArgument("coarse", f"a layer of {path}", "one of a live stream, such as ws://HOST/live")
    with open_file(path) as stream:
        yield stream
