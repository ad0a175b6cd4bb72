"""Makes materials (how a surface vibrates under a sliding hand) of recorded accelerations, and stores them in
a stream.

See `touchfield.render.material`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import InvalidArgument, require_ending, warn_unbounded
from touchfield.perception.vibrotactile import band_rms, dft321, handle_force_n
from touchfield.pipeline.decoding import stream_of
from touchfield.render.material import KEY, Material, stored_json
from touchfield.sources.recordings.recording import Recording


def texture_of(
    recordings: Sequence[Recording],
    speeds_m_s: Sequence[float],
    forces_n: Sequence[float],
    name: str = "recorded",
    friction: float | None = None,
) -> Material:
    """Compute a material from recorded accelerations of a sliding tool.

    speeds_m_s, forces_n : float [recordings]; speed of the tool along the surface, and force with which it
        pressed, for each recording.
    There must be one recording for each speed at each force. The three axes are reduced to one (`dft321`),
    converted to the force that shakes a hand with a stylus in the same way (`handle_force_n`), and measured
    as rms in thirds of an octave. Raises `InvalidArgument` if a combination of speed and force is missing or
    given twice, or a recording is shorter than 0.5 s.
    """
    if not recordings or not len(recordings) == len(speeds_m_s) == len(forces_n):
        found = f"{len(recordings)} recordings, {len(speeds_m_s)} speeds and {len(forces_n)} forces"
        raise InvalidArgument("recordings", found, "one speed and one force for each, in the same order")
    levels = {}
    for recording, speed, force in zip(recordings, speeds_m_s, forces_n, strict=True):
        shaken_n = handle_force_n(dft321(recording.acceleration_m_s2), recording.rate_hz)
        levels[float(speed), float(force)] = tuple(map(float, band_rms(shaken_n, recording.rate_hz)))
    speeds, forces = (tuple(sorted({key[n] for key in levels})) for n in range(2))
    if not len(levels) == len(recordings) == len(speeds) * len(forces):
        found = f"{len(recordings)} for {len(speeds)} speeds and {len(forces)} forces"
        raise InvalidArgument("recordings", found, "each speed at each force, once")
    table = tuple(tuple(levels[speed, force] for force in forces) for speed in speeds)
    return Material(name, friction, speeds_m_s=speeds, forces_n=forces, texture_rms_n=table)


def merge_materials(*tables: Sequence[Material]) -> tuple[Material, ...]:
    """Return the materials of all tables; of materials with the same name, the last."""
    return tuple({material.name: material for table in tables for material in table}.values())


def store_materials(stream: str | Path, materials: Sequence[Material], out: str | Path) -> None:
    """Copy a stream with these materials in its provenance.

    Nothing is decoded, and nothing else is changed. Raises `InvalidArgument` if the table is longer than 4096
    characters, `FormatError` if the stream is invalid, `SourceError` if the file cannot be written.
    """
    require_ending(out, "OUT.touch")
    text = stored_json(materials)
    with TouchReader(stream) as reader, TouchWriter(out) as writer:
        warn_unbounded(stream_of(reader).error_bound().get("error_bound_note"))
        writer.write_head(reader.head, {**reader.provenance, KEY: text})
        for n in range(reader.object_count):
            writer.write_object(reader.read_object(n))
        for n, entry in enumerate(reader.segments):
            vibration = reader.read_vibration(n)
            if vibration is not None:
                writer.write_vibration(entry.first_frame, entry.frame_count, vibration)
            writer.write_segment(entry.first_frame, entry.frame_count, reader.read_segment(n))
