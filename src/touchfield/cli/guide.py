"""Command `guide`: a depth camera's nearest surfaces, steps and holes, on an array of actuators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from touchfield.cli.main import Options, command
from touchfield.cli.options import fields_of, rows, rows_of, with_options
from touchfield.cli.output import Answer, check_results, echo
from touchfield.guidance.spec import GuideSpec
from touchfield.sources.options import SourceOptions
from touchfield.tasks.guide_options import GuideRun

_SOURCE: Final = (
    "Folder or file of depth pictures (docs/depth-sequences.md); or camera:N (a depth camera, by OpenCV), "
    "watch:FOLDER (pictures that are put there), - (PNG pictures on standard input)."
)
_READ: Final = (
    "depth_scale", "intrinsics", "poses", "pose_form", "depth_encoding", "topic", "source_rate_hz",
)  # fmt: skip
_SCENE: Final = (
    *rows("Scene", ("as", str | None, None, "Kind of the source, where it is not recognised.")),
    *rows_of(SourceOptions, "Scene", *_READ),
)


@command(
    "Feel",
    "guide camera:0 --intrinsics 570,570,320,240 --pitch-deg 20",
    "guide rgbd_dataset_freiburg1_rpy --offline --log guide.csv --plot guide.png",
)
@with_options(rows_of(GuideRun), rows_of(GuideSpec, "Guidance"), _SCENE)
def guide(
    options: Options,
    source: Annotated[str, typer.Argument(help=_SOURCE)],
    log: Annotated[Path | None, "CSV to write: every frame and every warning."] = None,
    plot: Annotated[Path | None, "PNG to draw: directions, ground and warnings over time."] = None,
) -> Answer:
    """Show what is near a wearer's depth camera on a vest. No mobility aid: it replaces no cane."""
    from touchfield.tasks.guide import guide as run
    from touchfield.tasks.guide_log import Rows

    check_results((source,), log, plot=plot)
    spec = GuideSpec(**fields_of(GuideSpec, options))
    settings = GuideRun(**fields_of(GuideRun, options), guide=spec)
    read = SourceOptions(kind=options["as"], world="frames", **{name: options[name] for name in _READ})
    shown = Rows()
    figures, notes = run(
        source,
        settings,
        read,
        log=log,
        on_note=lambda note: echo(f"note: {note}", to_stderr=True),
        on_shown=shown.add if plot is not None else lambda time_s, shown: None,
    )
    if plot is not None:
        shown.draw(plot, f"{Path(source).name or source}: {settings.device}", spec)
        notes = (*notes, f"the picture is {plot}")
    return Answer(figures, source, notes if log is None else (*notes, f"the log is {log}"))
