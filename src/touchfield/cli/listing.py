"""Lists for people: the device profiles with where each figure comes from, and what a stream was asked to be."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict
from typing import Any

from touchfield.adapters.check import Check
from touchfield.cli.show import literal_console, show
from touchfield.devices import Device, devices
from touchfield.errors import CorruptFile
from touchfield.job import EncodeSpec

__all__ = ["list_checks", "list_devices", "stream_for_people"]


def list_checks(found: dict[str, list[Check]], as_json: bool) -> None:
    """Print what a doctor found: one line each, and how to mend what is missing."""
    if as_json:
        show({name: [asdict(one) for one in checks] for name, checks in found.items()}, "", True)
        return
    console = literal_console()
    for name, checks in found.items():
        console.print(name, style="bold")
        for one in checks:
            mend = f". {one.mend}" if one.mend and not one.is_there else ""
            console.print(
                f"  {'ok     ' if one.is_there else 'missing'}  {one.what}: {one.found}{mend}", soft_wrap=True
            )


def stream_for_people(summary: dict[str, Any]) -> dict[str, Any]:
    """A stream's summary with its spec cut down to what was asked for beyond the defaults."""
    provenance = dict(summary["provenance"])
    with suppress(CorruptFile, KeyError):
        asked = EncodeSpec.from_json(provenance["spec"]).asked()
        provenance["spec"] = asked or "all as by default"
    return {**summary, "provenance": provenance}


def list_devices(as_json: bool, verbose: bool) -> None:
    """Print the profiles as a table, or as one object that holds every value and its source."""
    if as_json:
        show({d.name: _profile(d) for d in devices()}, "", True)
        return
    from rich.table import Table

    console = literal_console()
    table = Table(title="device profiles", title_justify="left", box=None, pad_edge=False)
    table.add_column("name", no_wrap=True)
    for heading in ("type", "workspace mm", "samples", "peak N", "rate Hz", "unverified"):
        table.add_column(heading, overflow="fold")
    for d in devices():
        unverified = sum(source.startswith("unverified") for source in d.sources.values())
        table.add_row(
            d.name,
            "array" if d.is_array else "point",
            "x".join(f"{x:g}" for x in d.workspace_mm),
            "x".join(str(n) for n in d.lattice),
            f"{d.force_max_n:g}",
            "-" if d.rate_hz is None else f"{d.rate_hz:g}",
            f"{unverified} of {len(d.sources)}",
        )
    console.print(table)
    if not verbose:
        console.print("every value's source: touchfield devices --verbose, or --json")
        return
    for d in devices():
        console.print(f"\n{d.name}: {d.title}")
        for name, source in d.sources.items():
            console.print(f"  {name}: {source}")


def _profile(d: Device) -> dict[str, Any]:
    return {
        "title": d.title,
        "type": d.type,
        "axes": d.axes,
        "workspace_mm": list(d.workspace_mm),
        "lattice": list(d.lattice),
        "force_max_n": d.force_max_n,
        "force_continuous_n": d.force_continuous_n,
        "rate_hz": d.rate_hz,
        "resolution_mm": d.resolution_mm,
        "physical_mm": None if d.physical_mm is None else list(d.physical_mm),
        "pitch_mm": d.pitch_mm,
        "levels": d.levels,
        "panels": d.panels,
        "sources": dict(d.sources),
    }
