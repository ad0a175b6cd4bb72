"""The commands that broadcast: serve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchfield.cli.app import command

__all__: list[str] = []


@command("Broadcast", "serve streams", "serve streams --host 0.0.0.0 --token a-long-word")
def serve(
    folder: Annotated[Path, typer.Argument(help="Folder of .touch files, and of pages and videos beside them.")],
    host: Annotated[
        str, typer.Option(help="Address to listen at; beyond this machine only with a token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0: a free one.")] = 8075,
    token: Annotated[str | None, typer.Option(help="Word that a receiver must bring: ...?token=WORD.")] = None,
    is_open: Annotated[bool, typer.Option("--open", help="Let anyone read who reaches the address.")] = False,
    cors: Annotated[
        list[str] | None, typer.Option(help="Origin of web pages that may read, such as https://example.org; or *.")
    ] = None,
) -> None:
    """Serve a folder of streams: anyone plays them by their address, and fetches only what is felt."""
    from touchfield.stream.server import ServeSpec
    from touchfield.stream.server import serve as run

    run(ServeSpec(folder, host, port, token, is_open, tuple(cors or ())), typer.echo)
