"""Commands about the installation: `demo`, `devices` and `sources` (lists of what is supported), `doctor`
(checks and fixes), and `warmup` (compiles everything ahead)."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from touchfield.cli.main import Json, command
from touchfield.cli.output import Answer, literal_console, progress, show_table
from touchfield.devices import devices as profiles

_PROFILE_FIELDS = (
    "title", "type", "axes", "workspace_mm", "lattice", "force_max_n", "force_continuous_n", "rate_hz",
    "resolution_mm", "physical_mm", "pitch_mm", "levels", "panels", "sources",
)  # fmt: skip
"""Fields of a device profile in the output for programs."""


@command("Set up", "demo")
def demo(
    folder: Annotated[Path, typer.Argument(help="Folder for the results.")] = Path("demo"),
    as_json: Json = False,
) -> None:
    """Run the main job on real scenes that come with the libraries: no download, no device."""
    from touchfield.cli.demo import run_demo

    run_demo(folder, as_json)


@command("Set up", "devices --verbose", "devices --connected")
def devices(
    verbose: Annotated[bool, typer.Option(help="With all sources.")] = False,
    connected: Annotated[bool, typer.Option(help="Only the units that are connected.")] = False,
) -> Answer:
    """List the device profiles, with their sources, and the drivers that `play --device` takes."""
    from touchfield.devices.drivers.registry import device_kinds

    if connected:
        return _connected()
    by_name = {d.name: {name: getattr(d, name) for name in _PROFILE_FIELDS} for d in profiles()}
    drivers = {kind.name: kind.summary for kind in device_kinds()}
    forms = [(kind.form, kind.summary) for kind in device_kinds()]

    def print_text() -> None:
        _show_profiles(verbose)
        show_table(forms, ("device", ""), "drivers (play --device)")

    return Answer({"profiles": by_name, "drivers": drivers}, "", print_text=print_text)


def _connected() -> Answer:
    """Return the units that are connected, for each driver that can tell."""
    from touchfield.tasks.setup import connected_units

    found = connected_units()
    rows = [
        (kind, unit.unit or "-", unit.details, unit.hint if not unit.is_ready else "")
        for kind, units in found.items()
        for unit in units
    ]
    values = {
        kind: [{**asdict(unit), "is_ready": unit.is_ready, "text": unit.text} for unit in units]
        for kind, units in found.items()
    }

    def print_text() -> None:
        if rows:
            show_table(rows, ("driver", "unit", "state", ""), "connected units")
        for kind in (kind for kind, units in found.items() if not units):
            literal_console().print(f"{kind}: none found (touchfield doctor --device {kind})")

    return Answer(values, "", print_text=print_text)


def _show_profiles(verbose: bool) -> None:
    rows = []
    for d in profiles():
        unverified = sum(source.startswith("unverified") for source in d.sources.values())
        rows.append(
            (
                d.name,
                "x".join(map(str, (*d.lattice[:2], d.panels)[: 2 + (d.panels > 1)])) if d.is_array else "-",
                "x".join(f"{x:.0f}" for x in d.workspace_mm),
                f"{d.force_max_n:g}",
                "-" if d.rate_hz is None else f"{d.rate_hz:g}",
                f"{unverified} of {len(d.sources)}",
            )
        )
    headings = ("name", "actuators", "workspace mm", "peak N", "rate Hz", "unverified")
    show_table(rows, headings, "device profiles")
    console = literal_console()
    if not verbose:
        console.print("every value's source: touchfield devices --verbose, or --json")
        return
    for d in profiles():
        console.print(f"\n{d.name}: {d.title}")
        for name, source in d.sources.items():
            console.print(f"  {name}: {source}")


@command("Set up")
def sources() -> Answer:
    """List the kinds of source."""
    from touchfield.sources.registry import kinds

    return Answer({kind.name: kind.summary for kind in kinds()}, "kinds of source (--as NAME)")


@command("Set up", "doctor --device haply", "doctor --device forcedimension --delay")
def doctor(
    device: Annotated[str | None, "Only what this device needs: haply, bhaptics, ..."] = None,
    delay: Annotated[bool, "Open the device, and measure its delay without a force."] = False,
) -> Answer:
    """Check the installation and suggest fixes."""
    from touchfield.tasks.setup import examine

    report = examine(device, delay)

    def print_text() -> None:
        console = literal_console()
        for name, checks in report.items():
            console.print(name, style="bold")
            for check in checks:
                state = "ok     " if check.is_there else "missing"
                hint = f". {check.mend}" if check.mend and not check.is_there else ""
                console.print(f"  {state}  {check.what}: {check.found}{hint}", soft_wrap=True)

    values = {name: [asdict(check) for check in checks] for name, checks in report.items()}
    return Answer(values, "", print_text=print_text)


@command("Set up")
def warmup() -> None:
    """Compile all kernels now, so that the first real job does not wait for it."""
    from touchfield import tasks

    with progress("compile", later=("measures", "filters")) as report:
        tasks.setup.warm_up(report)
