"""Makes materials (how a surface vibrates under a sliding hand) of recorded accelerations, and stores them in
a stream.

See `touchfield.render.material`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.atomic import atomic_path
from touchfield.container import TouchReader, TouchWriter
from touchfield.container.writer import with_map
from touchfield.errors import InvalidArgument, require_ending, warn_unbounded
from touchfield.perception.vibrotactile import BANDS_HZ, band_rms, dft321, handle_force_n
from touchfield.pipeline.decoding import stream_of
from touchfield.render.material import KEY, Material, stored_json
from touchfield.sources.recordings.penn_hatt import TextureModels
from touchfield.sources.recordings.recording import STANDARD_GRAVITY_M_S2, Recording
from touchfield.sources.recordings.texture_sets import read_texture_recording

_SPEEDS: Final = 6  # of a table made of models
_FORCES: Final = 4
_MAX_NOTES: Final = 3
_SPECTRUM: Final = 1 << 13  # samples, so that the narrowest band has several bins


def texture_of(
    recordings: Sequence[Recording],
    speeds_m_s: Sequence[float],
    forces_n: Sequence[float],
    name: str = "recorded",
    friction: float | None = None,
    *,
    is_averaged: bool = False,
) -> Material:
    """Compute a material from recorded accelerations of a sliding tool.

    speeds_m_s, forces_n : float [recordings]; speed of the tool along the surface, and force with which it
        pressed, for each recording.
    is_averaged : bool; whether recordings of the same speed and force are averaged (mean power).
    There must be one recording for each speed at each force, or with `is_averaged` at least one. The three
    axes are reduced to one (`dft321`), converted to the force that shakes a hand with a stylus in the same
    way (`handle_force_n`), and measured as rms in thirds of an octave. Raises `InvalidArgument` if a
    combination of speed and force is missing or given twice, or a recording is shorter than 0.5 s.
    """
    if not recordings or not len(recordings) == len(speeds_m_s) == len(forces_n):
        found = f"{len(recordings)} recordings, {len(speeds_m_s)} speeds and {len(forces_n)} forces"
        raise InvalidArgument("recordings", found, "one speed and one force for each, in the same order")
    levels: dict[tuple[float, float], list[Float64s]] = {}
    for recording, speed, force in zip(recordings, speeds_m_s, forces_n, strict=True):
        shaken_n = handle_force_n(dft321(recording.acceleration_m_s2), recording.rate_hz)
        levels.setdefault((float(speed), float(force)), []).append(band_rms(shaken_n, recording.rate_hz))
    speeds, forces = (tuple(sorted({key[n] for key in levels})) for n in range(2))
    is_once = is_averaged or len(levels) == len(recordings)
    if not (is_once and len(levels) == len(speeds) * len(forces)):
        found = f"{len(recordings)} for {len(speeds)} speeds and {len(forces)} forces"
        expected = "each speed at each force" if is_averaged else "each speed at each force, once"
        raise InvalidArgument("recordings", found, expected)
    means = {key: np.sqrt(np.mean(np.square(rows), axis=0)) for key, rows in levels.items()}
    return _material(name, friction, speeds, forces, means)


def texture_of_files(
    paths: Sequence[Path],
    speeds_m_s: Sequence[float] | None,
    forces_n: Sequence[float] | None,
    name: str = "recorded",
    friction: float | None = None,
    full_scale_m_s2: float = STANDARD_GRAVITY_M_S2,
) -> tuple[Material, tuple[str, ...]]:
    """Read recordings and compute their material as `texture_of` does; also return notes.

    speeds_m_s, forces_n : float [paths]; None: what the file names of a known set state. If both are None,
        recordings of the same speed and force are averaged.
    Raises `SourceError` as `read_texture_recording`, `InvalidArgument` as `texture_of`, or if a speed or
    force is neither given nor stated.
    """
    recordings = [read_texture_recording(path, full_scale_m_s2) for path in paths]
    speeds = _given_or_stated("speed_m_s", speeds_m_s, [r.speed_m_s for r in recordings], paths)
    forces = _given_or_stated("force_n", forces_n, [r.force_n for r in recordings], paths)
    is_averaged = speeds_m_s is None and forces_n is None
    material = texture_of(
        [r.recording for r in recordings], speeds, forces, name, friction, is_averaged=is_averaged
    )
    notes = [note for r in recordings for note in r.notes]
    more = [f"The same of {len(notes) - _MAX_NOTES} more recordings."] if len(notes) > _MAX_NOTES else []
    averaged = f"Speed and force of {len(paths)} recordings are those of their names; where both are equal, "
    return material, (
        *notes[:_MAX_NOTES],
        *more,
        *([f"{averaged}they are averaged (mean power)."] if is_averaged else []),
    )


def _given_or_stated(
    option: str,
    given: Sequence[float] | None,
    stated: Sequence[float | None],
    paths: Sequence[Path],
) -> Sequence[float]:
    if given is not None:
        return given
    known = [value for value in stated if value is not None]
    if len(known) < len(stated):
        expected = f"one number, or one for each of {len(stated)} recordings: 0.05,0.1"
        raise InvalidArgument(
            option, f"nothing, and none in the name {paths[stated.index(None)].name}", expected
        )
    return known


def texture_of_models(models: TextureModels, name: str | None = None) -> Material:
    """Compute a material from texture models of the Penn Haptic Texture Toolkit.

    The levels of each model follow from the spectrum of its filter, and are converted as in `texture_of`.
    The table has 6 speeds and 4 forces, evenly spaced up to the highest of the models. Its power is
    interpolated linearly over the triangles of their speeds and forces; outside, it is that of the nearest
    model. Bands beyond half the rate are 0. Raises `InvalidArgument` if there are fewer than four models, or
    all have the same speed or force.
    """
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    rows = np.array([(model.speed_m_s, model.force_n) for model in models.models])
    highest = rows.max(axis=0)
    if not highest.all() or len(rows) < 4 or not np.ptp(rows, axis=0).all():
        found = f"{len(rows)} models up to {highest[0]:g} m/s and {highest[1]:g} N"
        raise InvalidArgument("models", found, "at least four, of several speeds and forces")
    power = _model_power(models)
    speeds, forces = (
        tuple(float(top) * (n + 1) / count for n in range(count))
        for top, count in zip(highest, (_SPEEDS, _FORCES))
    )
    at = np.array([(speed, force) for speed in speeds for force in forces]) / highest
    inside = LinearNDInterpolator(rows / highest, power)(at)
    nearest = NearestNDInterpolator(rows / highest, power)(at)
    levels = np.sqrt(np.where(np.isfinite(inside), inside, nearest)).reshape(_SPEEDS, _FORCES, -1)
    table = {(speeds[i], forces[j]): levels[i, j] for i, j in np.ndindex(_SPEEDS, _FORCES)}
    return _material(name or models.name, models.friction, speeds, forces, table)


def _model_power(models: TextureModels) -> Float64s:
    """Return the mean squares of the force in each band, newtons squared, float64 [models, 16]."""
    rate_hz, impulse = models.rate_hz, np.zeros(_SPECTRUM)
    impulse[0] = 1.0
    frequencies_hz: Float64s = np.asarray(np.fft.rfftfreq(_SPECTRUM, 1 / rate_hz), np.float64)
    force_per_acceleration = np.abs(np.fft.rfft(handle_force_n(impulse, rate_hz)))
    edges_hz = np.append(BANDS_HZ, BANDS_HZ[-1] * 10**0.1) * 10**-0.05
    band = np.searchsorted(edges_hz, frequencies_hz, side="right") - 1
    weights = (band[:, None] == np.arange(len(BANDS_HZ))).astype(np.float64)
    weights[:, edges_hz[1:] > rate_hz / 2] = 0.0
    spectra = np.array([
        2 * model.variance / _SPECTRUM * np.abs(model.response(frequencies_hz, rate_hz)) ** 2
        for model in models.models
    ])  # fmt: skip
    return np.asarray((spectra * force_per_acceleration**2) @ weights)


def _material(
    name: str,
    friction: float | None,
    speeds: tuple[float, ...],
    forces: tuple[float, ...],
    levels: dict[tuple[float, float], Float64s],
) -> Material:
    """Return the material of the levels at each speed and force, float64 [16] each."""
    table = tuple(tuple(tuple(map(float, levels[speed, force])) for force in forces) for speed in speeds)
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
    with TouchReader(stream) as reader, atomic_path(Path(out)) as temporary:
        _write_materials(reader, temporary, text)
        tactile_map = reader.read_map()
        if tactile_map is not None:
            temporary.write_bytes(with_map(temporary.read_bytes(), tactile_map))


def _write_materials(reader: TouchReader, out: Path, text: str) -> None:
    with TouchWriter(out) as writer:
        warn_unbounded(stream_of(reader).error_bound().get("error_bound_note"))
        writer.write_head(reader.head, {**reader.provenance, KEY: text})
        for n in range(reader.object_count):
            writer.write_object(reader.read_object(n))
        for n, entry in enumerate(reader.segments):
            vibration = reader.read_vibration(n)
            if vibration is not None:
                writer.write_vibration(entry.first_frame, entry.frame_count, vibration)
            writer.write_segment(entry.first_frame, entry.frame_count, reader.read_segment(n))
