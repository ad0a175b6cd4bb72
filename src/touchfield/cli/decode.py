"""Commands that only read a ``.touch`` file: `info` describes it, `decode` writes its force fields. They
import no encoder, so that they start fast."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from touchfield.cli.main import Stream, command
from touchfield.cli.output import Answer, progress
from touchfield.container import TouchReader
from touchfield.errors import CorruptFile, FormatError, warn_unbounded
from touchfield.files import refuse_overwriting


@command("Look", "info room.touch", "info room.touch --voxels --json")
def info(
    stream: Stream,
    voxels: Annotated[bool, "Also decode all of it: supported voxels, and the bits that each takes."] = False,
) -> Answer:
    """Describe the contents of a .touch file."""
    from touchfield.network.opening import open_stream

    with open_stream(stream) as opened:
        summary = opened.summary()
        warn_unbounded(summary.get("error_bound_note"))
        if voxels:
            with progress("decode") as report:
                summary |= opened.bits_of_voxels(opened.supported_voxels(report))
        found, notes = ({}, ()) if opened.is_live else map_summary(opened.reader)
    text = Answer(_shortened_spec(summary) | found, stream, notes, {"map_levels": "levels of the map"})
    return Answer(summary | found, str(stream), notes, print_text=text.show)


def map_summary(reader: TouchReader) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return what a file tells of its map, by stable keys, and a note if its map cannot be read."""
    from touchfield.pipeline.stored_map import StoredMap

    try:
        record = reader.read_map()
    except FormatError as error:
        return {}, (f"The map cannot be read; the frame can: {error}",)
    if record is None:
        return {}, ()
    stored = StoredMap(record, reader.name)
    return {"map": stored.summary(), "map_levels": stored.level_rows()}, ()


def _shortened_spec(summary: dict[str, Any]) -> dict[str, Any]:
    """Return a stream's summary with only those options of its spec that are not defaults."""
    provenance = dict(summary["provenance"])
    with suppress(CorruptFile, KeyError):
        from touchfield.pipeline.spec import EncodeSpec

        changed = EncodeSpec.from_json(provenance["spec"]).changed_options()
        provenance["spec"] = changed or "all as by default"
    return {**summary, "provenance": provenance}


@command("Make", "decode room.touch field.npz", "decode room.touch field.vti")
def decode(stream: Stream, out: Annotated[Path, "FIELD.npz, or FIELD.vti for ParaView."]) -> Answer:
    """Turn a .touch file back into a force field."""
    from touchfield.network.opening import open_stream
    from touchfield.pipeline.decoding import write_field

    refuse_overwriting(out, stream)
    with (
        open_stream(stream) as opened,
        progress("decode", compiles=opened.reader.head.coder != "touch") as report,
    ):
        written = write_field(out, opened.medium, report, opened.placement)
        summary = {
            "file": str(written),
            "frames": len(opened.medium),
            "grid_shape": list(opened.medium.grid.shape),
        }
    return Answer(summary, str(written))
