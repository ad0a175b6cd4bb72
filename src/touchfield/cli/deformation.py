"""The command of deformations: deform."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchfield.cli.app import Json, command
from touchfield.cli.options import frames_of
from touchfield.cli.show import check_picture, progress, show


@command(
    "Make",
    "encode fox.glb fox.touch --frames 60:61 --representation voxel",
    "deform fox.touch fox.glb -o walk.npz --frames 52:68 --rest-frame 60",
    "play fox.touch --deformation walk.npz --offline --seconds 2",
    "deform fox.touch -o soft.npz --yield-m-per-n 0.002 --relax-s 0.1",
)
def deform(
    stream: Annotated[Path, typer.Argument(help="Stream of voxels, .touch.")],
    model: Annotated[Path | None, typer.Argument(help="Animated glTF that STREAM shows at rest.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Deformation to write, .npz.")] = Path("deformation.npz"),
    controls: Annotated[int, typer.Option(help="Control points along each axis, 4 to 32.")] = 8,
    animation: Annotated[
        str | None, typer.Option(help="Name or number of MODEL's animation; default: the first.")
    ] = None,
    frames: Annotated[str | None, typer.Option(help="Frames of the animation to take, START:STOP.")] = None,
    rest_frame: Annotated[
        int | None, typer.Option(help="Frame of MODEL that STREAM shows; default: the first that is taken.")
    ] = None,
    rate_hz: Annotated[float, typer.Option(help="Frames a second of the tracks.")] = 60.0,
    yield_m_per_n: Annotated[float, typer.Option(help="Metres that the medium gives way for a newton.")] = 0.0,
    relax_s: Annotated[float, typer.Option(help="Time constant with which it does, seconds.")] = 0.05,
    as_json: Json = False,
) -> None:
    """Bend STREAM at the receiver: by the motion of a model, or under the finger."""
    from touchfield.job.deformation import Motion, tracks_of

    check_picture(stream, out)
    if model is not None:
        check_picture(model, out)
    motion = Motion(model, animation, frames_of("--frames", frames), rest_frame, rate_hz) if model else None
    with progress("deform", "frame") as report:
        done = tracks_of(
            stream, out, motion, controls=controls, compliance_m_per_n=yield_m_per_n, relax_s=relax_s, report=report
        )
    show({"file": str(out), **done.summary()}, str(out), as_json)
