"""Commands that open a stream, and need nothing of what makes one: info and decode."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from touchfield.cli.main import Stream, command
from touchfield.cli.show import Answer, progress
from touchfield.errors import CorruptFile, warn_unbounded
from touchfield.files import keep_sources


@command("Look", "info room.touch", "info room.touch --voxels --json")
def info(
    stream: Stream,
    voxels: Annotated[bool, "Also decode all of it: supported voxels, and the bits that each takes."] = False,
) -> Answer:
    """Say what a .touch file holds."""
    from touchfield.pipeline.decoding import open_stream

    with open_stream(stream) as opened:
        shown = opened.summary()
        warn_unbounded(shown.get("error_bound_note"))
        if voxels:
            with progress("decode") as report:
                shown |= opened.bits_of_voxels(opened.supported_voxels(report))
    return Answer(shown, str(stream), people=lambda: Answer(_for_people(shown), stream).show())


def _for_people(summary: dict[str, Any]) -> dict[str, Any]:
    """A stream's summary with its spec cut down to what was asked for beyond the defaults."""
    provenance = dict(summary["provenance"])
    with suppress(CorruptFile, KeyError):
        from touchfield.pipeline.spec import EncodeSpec

        asked = EncodeSpec.from_json(provenance["spec"]).asked()
        provenance["spec"] = asked or "all as by default"
    return {**summary, "provenance": provenance}


@command("Make", "decode room.touch field.npz", "decode room.touch field.vti")
def decode(stream: Stream, out: Annotated[Path, "FIELD.npz, or FIELD.vti for ParaView."]) -> Answer:
    """Turn a .touch file back into a force field."""
    from touchfield.pipeline.decoding import open_stream, write_field

    keep_sources(out, stream)
    with open_stream(stream) as opened, progress("decode", compiles=not opened.is_native) as report:
        written = write_field(out, opened.medium, report, opened.placement)
        shown = {
            "file": str(written),
            "frames": len(opened.medium),
            "grid_shape": list(opened.medium.grid.shape),
        }
    return Answer(shown, str(written))
