"""The command line's app, and the arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchfield.sources.samples import SAMPLES

__all__ = ["FieldFile", "Json", "Source", "Stream", "app"]

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

_SAMPLES = ", ".join(f"sample:{name}" for name in SAMPLES)

Json = Annotated[bool, typer.Option("--json", help="Print one machine-readable object.")]
Source = Annotated[str, typer.Argument(help=f"File or folder, or {_SAMPLES}.")]
Stream = Annotated[Path, typer.Argument(help="A .touch file.")]
FieldFile = Annotated[Path, typer.Argument(help="FIELD.npz, or FIELD.vti for ParaView.")]
