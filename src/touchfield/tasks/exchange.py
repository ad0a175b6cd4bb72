"""Exports a stream to the formats of other tools, such as drives of actuators, and imports haptic effects
from them.

Imported effects are symbolic media (paper figure 1).

stream -> array of actuators -> drives -> .hjif, .tact, .wav, .haptic, .ahap      `export`
stream + trajectory of a probe -> force over time -> .hjif, .wav                  `export`
stream -> the page in the browser -> .html                                        `export`
.hjif, .hmpg, .ahap, .haptic, .tact -> drives -> symbolic medium -> stream        `import_effect`

The force over time is that of the field at the probe, at every tick of the file: a thousand per second, or
fewer for more than 65 s. The probe moves in a straight line from one sample to the next, and waits at the
first. Friction, damping and device limits depend on the hand and are left to the receiver; only forces above
the peak are clipped to it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.compute.threads import Progress, silent
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument, require_ending, require_one_of
from touchfield.exchange.ahap import read_ahap
from touchfield.exchange.effect_files import (
    RATE_HZ as WAV_RATE_HZ,
    fits_vest,
    write_ahap,
    write_haptic,
    write_tact,
    write_wav,
    write_wav_array,
)
from touchfield.exchange.haptic_read import read_haptic
from touchfield.exchange.hjif_import import read_hjif_array
from touchfield.exchange.hjif_read import DEFAULT_TIMESCALE
from touchfield.exchange.hjif_write import MAX_SPAN_TICKS, write_hjif_array, write_hjif_force
from touchfield.exchange.symbolic import (
    DEFAULT_RATE_HZ,
    MAX_MEDIUM_VALUES,
    ArrayEffect,
    checked_frames,
    effect_device,
    effect_medium,
)
from touchfield.exchange.tact_read import read_tact
from touchfield.filters.device_spec import device_grid
from touchfield.medium.trace import HAPTIC_RATE_HZ, Trace, read_trace
from touchfield.network.opening import open_stream
from touchfield.pipeline.array_medium import PANELS, Drives, array_drives
from touchfield.pipeline.encoding import Encoded, encode_prepared
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.result import Result
from touchfield.pipeline.source import FixedLatticeScene, Source
from touchfield.pipeline.spec import EncodeSpec
from touchfield.pipeline.stream import FILTERED, OpenStream, stream_device
from touchfield.render.sampler import FieldSampler
from touchfield.tasks.view import view

EXPORTS: Final = (".hjif", ".tact", ".wav", ".haptic", ".ahap", ".html")
_FORCES: Final = (".hjif", ".wav")  # the formats of a force over time
_READERS: Final = {
    ".hjif": read_hjif_array, ".hmpg": read_hjif_array, ".ahap": read_ahap, ".haptic": read_haptic,
    ".tact": read_tact,
}  # fmt: skip
IMPORTS: Final = tuple(_READERS)
_MAX_SAMPLES: Final = 1 << 23
_SAME_SIGNAL: Final = 0.25
_SAME_SIGNAL_FLOOR: Final = 0.02
"""A vibration within these of the force, of which an import makes both, is the same signal, coded twice."""
_PARTS_IN_HJIF: Final = (
    "The force and the vibration are two perceptions: a reader of vibration alone does not play the force."
)
_PARTS_LOST: Final = "The force and the vibration become one drive, the greater of the two."
_VEST: Final = "tactsuit-x40"


def export(
    stream: str | Path,
    out: str | Path,
    device_name: str | None = None,
    trajectory: str | Path | None = None,
    panel: str = PANELS[0],
    report: Progress = silent,
    full_scale_n: float = 1.0,
    against: Source | None = None,
) -> Result:
    """Write a stream in another format, chosen by the suffix of `out`.

    ``.hjif`` (ISO/IEC 23090-31) and ``.wav`` (one channel for each actuator) contain the drives of an array.
    With `trajectory`, the positions of a probe over time (`touchfield.medium.trace.read_trace`), they contain
    a force over time. ``.tact`` is for a vest of bHaptics; ``.haptic`` (Meta) and ``.ahap`` (Apple) have one
    track; ``.html`` is the page that contains the stream. `device_name` is the profile of an array, or with
    `trajectory` of a point: by default the device that the stream was made for; for ``.tact`` a TactSuit X40
    if that is not a vest. `panel` is that of an array, "front" or "back". `against` is the source to show in
    the page. `full_scale_n` is the force in newtons that ``.hjif`` stores as 1; with 1 the values are
    newtons. Raises TouchfieldError; no file `out` is then left.
    """
    path = Path(out)
    kind = path.suffix.lower()
    require_ending(path, *EXPORTS)
    if trajectory is not None and kind not in _FORCES:
        expected = f"one for {' or '.join(_FORCES)} only"
        raise InvalidArgument("trajectory", f"one for {kind}", expected, "A pattern has no forces.")
    if full_scale_n != 1 and (trajectory is None or kind != ".hjif"):
        raise InvalidArgument("full_scale_n", repr(full_scale_n), "it for a force as .hjif only")
    if against is not None and kind != ".html":
        raise InvalidArgument("--source", f"one for {kind}", "one for .html only")
    if device_name is not None and kind == ".html":
        raise InvalidArgument("--device", f"one for {kind}", "one for drives or a force only")
    if panel != PANELS[0] and (trajectory is not None or kind == ".html"):
        raise InvalidArgument("--panel", repr(panel), "it for the drives of an array only")
    with open_stream(stream) as opened:
        if kind == ".html":
            head, page = opened.reader.head, view(stream, against, report)
            page.save(path)
            figures = {"frames": head.frame_count}
            figures |= {key: page.figures[key] for key in ("source_bytes",) if key in page.figures}
            return _export_result(path, head.device_name, head.frame_count / head.rate_hz, figures)
        if trajectory is not None:
            return _export_force(opened, path, kind, device_name, trajectory, full_scale_n)
        return _export_array(opened, path, kind, device_name, panel, report)


def import_effect(
    source: str | Path,
    out: str | Path,
    spec: EncodeSpec | None = None,
    rate_hz: float = DEFAULT_RATE_HZ,
    force_max_n: float | None = None,
    report: Progress = silent,
) -> Encoded:
    """Import an effect as a ``.touch`` file: a symbolic medium for an array of actuators.

    A stream stores the drive as a force, within the error bound of its coder, and as a vibration, with the
    frequency in whole hertz and the drive to within a ninth (`touchfield.codec.vibration`). A receiver
    renders the greater of the two. `source` is ``.hjif``, ``.hmpg`` (its binary form), ``.ahap`` (Apple),
    ``.haptic`` (Meta) or ``.tact`` (bHaptics). Of `spec` the coder, haptic filters, frames and vibration are
    used; the device is that of the effect. `rate_hz` is the number of frames per second, and `force_max_n`
    the force of a full drive: None is that of the file, or else 3.3 N. Raises TouchfieldError; no file `out`
    is then left.
    """
    options = spec or EncodeSpec()
    if force_max_n is not None and not 0 < force_max_n <= 1e6:
        raise InvalidArgument("force_max_n", repr(force_max_n), "newtons above 0, up to a million")
    kind = Path(source).suffix.lower()
    require_ending(source, *IMPORTS)
    require_ending(out, "OUT.touch")
    pattern = _READERS[kind](source, rate_hz)
    full_n = pattern.force_max_n if force_max_n is None else force_max_n
    effect_profile = effect_device(pattern.effect.lattice, pattern.device_name, full_n)
    symbolic = effect_medium(
        pattern.effect, device_grid(effect_profile), effect_profile.force_max_n, {"format": kind[1:]}
    )
    prepared = prepare(
        FixedLatticeScene(symbolic, effect_profile, pattern.notes),
        replace(options, device=effect_profile.name, nw=None),
    )
    prepared = replace(prepared, reference=FILTERED)
    return encode_prepared(prepared, out, file_provenance(source, prepared), report)


def _export_result(
    path: Path, device_name: str, seconds: float, figures: dict[str, Any], notes: tuple[str, ...] = ()
) -> Result:
    size = path.stat().st_size
    return Result({"file_bytes": size, "device": device_name, "seconds": seconds, **figures}, notes)


def _export_array(
    stream: OpenStream, path: Path, kind: str, device_name: str | None, panel: str, report: Progress
) -> Result:
    require_one_of("panel", panel, PANELS)
    target = _target_array(stream, kind, device_name)
    # the back of a profile with one panel is its front, worn on the back
    drives = array_drives(stream, target, panel if target.panels > 1 else PANELS[0])
    columns, rows, _ = target.lattice
    checked_frames("stream", len(drives), columns * rows, MAX_MEDIUM_VALUES)
    panel_index = PANELS.index(panel) if target.panels > 1 else 0
    effect = _array_effect(drives, panel_index, rows, columns, report)
    notes: tuple[str, ...] = ()
    title = f"{Path(stream.reader.provenance.get('source', '')).name or 'a stream'} for {target.name}"
    if effect.parts is not None:
        keeps_parts = kind == ".hjif" and len(effect) / effect.rate_hz <= MAX_SPAN_TICKS / DEFAULT_TIMESCALE
        notes = (_PARTS_IN_HJIF if keeps_parts else _PARTS_LOST,)
        effect = effect if keeps_parts else replace(effect, parts=None)
    if kind == ".tact":
        write_tact(path, effect, panel=panel)
        if effect.frequencies_hz is not None:
            notes += ("The frequencies are left out: a vest of bHaptics has none.",)
    elif kind == ".wav":
        notes += write_wav_array(path, effect)
    elif kind == ".hjif":
        write_hjif_array(
            path, effect, target.name, panel=panel, description=title, force_max_n=drives.force_max_n
        )
    else:
        notes += (write_ahap if kind == ".ahap" else write_haptic)(path, effect, path.stem, title)
    figures = {
        "columns": columns,
        "rows": rows,
        "panel": panel,
        "frames": len(effect),
        "rate_hz": effect.rate_hz,
    }
    if "height" in (target.shows, stream_device(stream).shows):
        notes = (
            *notes,
            f"{kind} knows no pins: who reads it takes the heights of a pin display for vibration.",
        )
    if not effect.drives.any():
        notes = (*notes, "The result is empty: no actuator is driven.")
    return _export_result(path, target.name, len(effect) / effect.rate_hz, figures, notes)


def _array_effect(drives: Drives, panel_index: int, rows: int, columns: int, report: Progress) -> ArrayEffect:
    """The drives of one panel; with parts if the vibration is not that of the drives."""
    shape = (len(drives), rows, columns)
    forces, vibrations = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    frequency_frames = None if drives.medium.vibration is None else np.zeros(shape, np.float32)
    for i in range(len(drives)):
        forces[i], vibrations[i] = (part[panel_index] for part in drives.parts(i))
        frequencies = drives.frequencies(i)
        if frequency_frames is not None and frequencies is not None:
            frequency_frames[i] = frequencies[panel_index]
        report(i + 1, len(drives))
    differs = np.abs(vibrations - forces) > _SAME_SIGNAL * forces + _SAME_SIGNAL_FLOOR
    if (differs & (vibrations > 0)).any():
        return ArrayEffect.from_parts(drives.rate_hz, forces, vibrations, frequency_frames)
    # the steps of the vibration are coarse: where there is a force, it is the more accurate drive
    same = np.where(forces > 0, forces, vibrations)
    return ArrayEffect(drives.rate_hz, same, frequency_frames)


def _target_array(stream: OpenStream, kind: str, device_name: str | None) -> Device:
    """Return the requested array, else that of the stream, or the default vest for ``.tact``."""
    if device_name is not None:
        return device(device_name)
    head = stream.reader.head
    columns, rows, depth = head.grid_shape
    stream_array = (
        effect_device((columns, rows, depth), head.device_name, head.force_max_n)
        if head.device_type == 2
        else None
    )
    if kind == ".tact":
        return stream_array if stream_array is not None and fits_vest(stream_array.lattice) else device(_VEST)
    if stream_array is None:
        hint = "Name an array with --device, or a trajectory for the force along it."
        raise InvalidArgument(
            "device", f"a stream for {head.device_name}, a point", "an array of actuators", hint
        )
    return stream_array


def _export_force(
    stream: OpenStream,
    path: Path,
    kind: str,
    device_name: str | None,
    trajectory: str | Path,
    full_scale_n: float,
) -> Result:
    head = stream.reader.head
    name, peak_n = head.device_name, head.force_max_n
    if device_name is not None:
        target = device(device_name)
        if target.is_array:
            raise InvalidArgument("device", f"{target.name}, an array", "a point (type 1) with a trajectory")
        name, peak_n = target.name, target.force_max_n
    trace = read_trace(trajectory)
    timescale = WAV_RATE_HZ if kind == ".wav" else _ticks_per_second(trace)
    if trace.times_s[-1] * timescale > _MAX_SAMPLES:
        limit = f"at most {_MAX_SAMPLES / timescale:g} s"
        raise InvalidArgument("trajectory", f"{trace.times_s[-1]:g} s", limit, "Cut it.")
    times_s = np.arange(max(1, math.floor(trace.times_s[-1] * timescale + 1e-6) + 1)) / timescale
    positions_m = np.stack([np.interp(times_s, trace.times_s, of) for of in trace.positions_m.T], axis=1)
    field_n = FieldSampler(stream.scene or stream.medium).force_n(times_s, positions_m).astype(np.float64)
    magnitude_n = np.linalg.norm(field_n, axis=1, keepdims=True)
    forces_n = field_n * np.minimum(1, peak_n / np.maximum(magnitude_n, peak_n))
    along_n = float(np.abs(forces_n).max())
    notes: tuple[str, ...] = ()
    if kind == ".wav":
        write_wav(path, [forces_n / (along_n or 1.0)], 3, len(forces_n))
        notes = (f"Full scale is {along_n:.6g} N, the greatest force along an axis: a sound has no newtons.",)
    else:
        title = f"force along {Path(trajectory).name}"
        write_hjif_force(
            path, forces_n, timescale, device_name=name, full_scale_n=full_scale_n, description=title
        )
        if along_n > full_scale_n:
            notes = (
                "Readers that put it out as sound, such as the reference synthesiser, clip above "
                f"{full_scale_n:g} N; --full-scale-n {along_n:.3g} tells shares of that instead.",
            )
    if (magnitude_n > peak_n).any():
        fraction = float(np.mean(magnitude_n > peak_n))
        notes = (
            f"{100 * fraction:.3g} % of the samples exceed {peak_n:g} N and are clipped to it.",
            *notes,
        )
    if not forces_n.any():
        notes = ("The result is empty: the trajectory meets no force.",)
    greatest_n = float(np.linalg.norm(forces_n, axis=1).max())
    figures: dict[str, Any] = {"samples": len(times_s), "ticks_per_second": timescale}
    figures |= {"force_max_n": peak_n, "greatest_n": greatest_n}
    return _export_result(path, name, float(times_s[-1]), figures, notes)


def _ticks_per_second(trace: Trace) -> int:
    """Return a thousand ticks a second, or fewer if that would not fit into one effect."""
    seconds = float(trace.times_s[-1])
    ticks = min(round(HAPTIC_RATE_HZ), math.floor(MAX_SPAN_TICKS / max(seconds, 1.0)))
    if ticks < 1:
        raise InvalidArgument("trajectory", f"{seconds:g} s", f"at most {MAX_SPAN_TICKS} s", "Cut it.")
    return ticks
