"""The receiver's commands: play, export, import, doctor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from touchfield.cli.app import Json, Stream, app
from touchfield.cli.options import asks
from touchfield.cli.play import RENDER, render_spec
from touchfield.cli.show import check_picture, keep_source, progress, show

__all__: list[str] = []

Trajectory = Annotated[Path | None, typer.Option(help="Where the probe goes: CSV of t_s,x_m,y_m,z_m.")]


@app.command()
@asks(RENDER)
def play(
    stream: Stream,
    device: Annotated[
        str,
        typer.Option(help="sim, sim:spring, haply, openhaptics, forcedimension, bhaptics, osc:HOST:PORT, pins:PORT."),
    ] = "sim",
    profile: Annotated[
        str | None, typer.Option(help="Profile whose limits and actuators hold; default: the device's own.")
    ] = None,
    trajectory: Trajectory = None,
    log: Annotated[Path | None, typer.Option(help="CSV to write: every tick.")] = None,
    plot: Annotated[Path | None, typer.Option(help="PNG to draw: the hand, the field, the forces.")] = None,
    seconds: Annotated[float | None, typer.Option(help="How long; default: the trajectory, or the medium.")] = None,
    start_s: Annotated[float, typer.Option("--start-s", help="Where the medium begins.")] = 0.0,
    speed: Annotated[float, typer.Option(help="Seconds of the medium in one of yours.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    panel: Annotated[str, typer.Option(help="Of an array with two panels: front or back.")] = "front",
    offline: Annotated[
        bool, typer.Option("--offline", help="sim: no clock, as fast as it goes; the same forces.")
    ] = False,
    as_json: Json = False,
    trace: Annotated[
        Path | None, typer.Option(help="As --trajectory, but in the metres and axes of the scene: a recording.")
    ] = None,
    wav: Annotated[Path | None, typer.Option(help="WAV to write: the play as sound.")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Play nothing; tell whether this machine can decode it in time.")
    ] = False,
    *,
    asked: dict[str, Any],
) -> None:
    """Feel STREAM on a device, or on a simulated hand."""
    from touchfield.job.play import PlaySpec
    from touchfield.job.play import play as run

    if check:
        _check(stream, speed, as_json)
        return
    for target in (log, plot, wav):
        check_picture(stream, target)
    spec = PlaySpec(
        device, profile, trajectory, seconds, start_s, speed, loop, panel, offline,
        is_logged=not (log is plot is wav is None), is_drawn=plot is not None, render=render_spec(asked), trace=trace,
    )  # fmt: skip
    with progress("play", "s") as report:
        played = run(stream, spec, report, _say)
    notes = played.notes
    if log is not None:
        played.write_log(log)
        notes = (*notes, f"the log is {log}")
    if plot is not None and played.error is None:
        played.draw(plot)
        notes = (*notes, f"the picture is {plot}")
    if wav is not None and played.error is None:
        notes = (*notes, played.write_wav(wav))
    if played.is_starved:
        share = played.statistics["stalled_share"]
        notes = (
            *notes,
            f"{100 * share:.3g} % of the time there was nothing, as frames came too late: this has failed",
        )
    show(played.statistics, str(stream), as_json, notes)
    played.checked()
    if played.is_starved:
        raise typer.Exit(1)


def _check(stream: Path, speed: float, as_json: bool) -> None:
    """Tell whether a stream can be decoded in time; exit code 1 where not."""
    from touchfield.job.play_check import check_play

    told = check_play(stream, speed)
    show(told, str(stream), as_json)
    if not told["can_play"]:
        raise typer.Exit(1)


def _say(note: str) -> None:
    """Print a note at once, beside the result."""
    typer.echo(f"note: {note}", err=True)


@app.command()
def export(
    stream: Stream,
    out: Annotated[
        Path, typer.Argument(help="OUT.hjif (ISO/IEC 23090-31), .tact (bHaptics), .wav, .haptic (Meta) or .ahap.")
    ],
    device: Annotated[
        str | None, typer.Option(help="Profile: the array whose drives are written; default: the stream's.")
    ] = None,
    trajectory: Trajectory = None,
    panel: Annotated[str, typer.Option(help="Of an array with two panels: front or back.")] = "front",
    full_scale_n: Annotated[
        float,
        typer.Option("--full-scale-n", help="A force as .hjif: newtons told as 1, for readers that clip there."),
    ] = 1.0,
    as_json: Json = False,
) -> None:
    """Write STREAM in another format: the drives of an array, or with --trajectory the force along it."""
    from touchfield.job.exchange import export as run

    keep_source(stream, out)
    if trajectory is not None:
        keep_source(trajectory, out)
    with progress("export") as report:
        done = run(stream, out, device, trajectory, panel, report, full_scale_n)
    show(done.summary(), str(out), as_json, done.notes)


@app.command(name="import")
def import_(
    effect: Annotated[Path, typer.Argument(help="EFFECT.hjif, its binary form EFFECT.hmpg, or EFFECT.ahap.")],
    out: Annotated[Path, typer.Argument(help="The .touch file to write.")],
    rate_hz: Annotated[float, typer.Option("--rate-hz", help="Frames a second of the medium.")] = 100.0,
    force_max_n: Annotated[
        float | None, typer.Option("--force-max-n", help="Force of a full drive; default: the file's, or 3.3.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Turn an effect into a .touch file: a symbolic medium for an array of actuators."""
    from touchfield.job.exchange import import_effect

    keep_source(effect, out)
    with progress("import") as report:
        done = import_effect(effect, out, None, rate_hz, force_max_n, report)
    show(done.summary(), str(out), as_json, done.notes)


@app.command()
def doctor(
    device: Annotated[str | None, typer.Option(help="Only what this device needs: haply, bhaptics, ...")] = None,
    as_json: Json = False,
) -> None:
    """Say what is installed, what is missing, and how to mend it."""
    from touchfield.cli.listing import list_checks
    from touchfield.job.setup import examine

    list_checks(examine(device), as_json)
