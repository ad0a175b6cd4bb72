"""Commands that open a stream, and need nothing of what makes one: info and decode."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated, Any

from touchfield.cli.main import FieldFile, Json, Stream, command
from touchfield.cli.show import keep_source, progress, show
from touchfield.errors import CorruptFile


@command("Look", "info room.touch", "info room.touch --voxels --json")
def info(
    stream: Stream,
    as_json: Json = False,
    voxels: Annotated[bool, "Also decode all of it: supported voxels, and the bits that each takes."] = False,
) -> None:
    """Say what a .touch file holds."""
    from touchfield.stream.opened import open_stream

    with open_stream(stream) as opened:
        shown = opened.summary()
        if voxels:
            with progress("decode") as report:
                shown |= opened.bits_of_voxels(opened.supported_voxels(report))
    show(shown if as_json else _for_people(shown), str(stream), as_json)


def _for_people(summary: dict[str, Any]) -> dict[str, Any]:
    """A stream's summary with its spec cut down to what was asked for beyond the defaults."""
    provenance = dict(summary["provenance"])
    with suppress(CorruptFile, KeyError):
        from touchfield.job import EncodeSpec

        asked = EncodeSpec.from_json(provenance["spec"]).asked()
        provenance["spec"] = asked or "all as by default"
    return {**summary, "provenance": provenance}


@command("Make", "decode room.touch field.npz", "decode room.touch field.vti")
def decode(stream: Stream, out: FieldFile, as_json: Json = False) -> None:
    """Turn a .touch file back into a force field."""
    from touchfield.stream.opened import open_stream, write_field

    keep_source(stream, out)
    with open_stream(stream) as opened, progress("decode", compiles=not opened.is_native) as report:
        written = write_field(out, opened.medium, report, opened.placement)
        shown = {"file": str(written), "frames": len(opened.medium), "grid_shape": list(opened.medium.grid.shape)}
    show(shown, str(written), as_json)
