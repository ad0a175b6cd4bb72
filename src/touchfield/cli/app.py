"""The command line's app, how a command joins it, and the arguments that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from touchfield.sources.samples import SAMPLES

PANELS = ("Make", "Look", "Feel", "Broadcast", "Study", "Set up")
"""The groups of commands, by what one is about to do."""

app = typer.Typer(rich_markup_mode="rich", pretty_exceptions_enable=False)

_SAMPLES = ", ".join(f"sample:{name}" for name in SAMPLES)

Json = Annotated[bool, typer.Option("--json", help="Print one machine-readable object; an error, too, as one.")]
Source = Annotated[str, typer.Argument(help=f"File or folder, or {_SAMPLES}.")]
Stream = Annotated[str, typer.Argument(help="A .touch file, or the address of one: https://...")]
Trajectory = Annotated[Path | None, typer.Option(help="Where the probe goes: CSV of t_s,x_m,y_m,z_m.")]
FieldFile = Annotated[Path, typer.Argument(help="FIELD.npz, or FIELD.vti for ParaView.")]


def command(panel: str, *examples: str, name: str | None = None) -> Callable[[Callable[..., Any]], Any]:
    """Make a function a command of one of `PANELS`, with examples at the end of its help."""
    told = [f"touchfield {example}" for example in examples]
    epilog = "\n\n".join(["Examples:", *told]) if told else None
    return app.command(name=name, rich_help_panel=panel, epilog=epilog)
