"""Streams into the formats of others, and effects of others into streams (paper figure 1: symbolic media).

stream -> array of actuators -> drives -> .hjif, .tact, .wav, .haptic, .ahap     `export`
stream + trajectory of a probe -> force over time -> .hjif, .wav                 `export`
stream -> the page in the browser -> .html                                        `export`
.hjif, .hmpg, .ahap -> drives -> symbolic medium -> stream   `import_effect`

The force over time is that of the field where the probe is, at every tick of the file, a thousand a second
(fewer beyond 65 s), the probe going straight from one sample to the next and waiting at the first. What the
receiver adds, friction, damping and its device's limits, depends on the hand: only what exceeds the peak is
shortened to it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.compute.threads import Report, silent
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument, require_ending, require_one_of
from touchfield.exchange.ahap import read_ahap
from touchfield.exchange.effect_files import RATE_HZ as WAV_RATE_HZ
from touchfield.exchange.effect_files import (
    fits_vest,
    write_ahap,
    write_haptic,
    write_tact,
    write_wav,
    write_wav_array,
)
from touchfield.exchange.hjif_import import read_hjif_array
from touchfield.exchange.hjif_write import MAX_SPAN_TICKS, write_hjif_array, write_hjif_force
from touchfield.exchange.symbolic import (
    DEFAULT_RATE_HZ,
    MAX_MEDIUM_VALUES,
    ArrayEffect,
    checked_frames,
    effect_device,
    effect_medium,
)
from touchfield.filters.device_filter import device_grid
from touchfield.medium.trace import HAPTIC_RATE_HZ, Trace, read_trace
from touchfield.pipeline.array_medium import PANELS, array_drives, stream_device
from touchfield.pipeline.decoding import FILTERED, OpenStream, open_stream
from touchfield.pipeline.encoding import Encoded, encode_prepared, provenance_of
from touchfield.pipeline.preparation import KeptScene, Source, prepare
from touchfield.pipeline.result import Result
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.sampler import FieldSampler
from touchfield.tasks.view import view

EXPORTS: Final = (".hjif", ".tact", ".wav", ".haptic", ".ahap", ".html")
_FORCES: Final = (".hjif", ".wav")  # of these, what holds a force over time
IMPORTS: Final = (".hjif", ".hmpg", ".ahap")
_MOST_SAMPLES: Final = 1 << 23
_VEST: Final = "tactsuit-x40"


def export(
    stream: str | Path,
    out: str | Path,
    device_name: str | None = None,
    trajectory: str | Path | None = None,
    panel: str = PANELS[0],
    report: Report = silent,
    full_scale_n: float = 1.0,
    against: Source | None = None,
) -> Result:
    """Write a stream in another format, by the ending of `out`.

    ``.hjif`` (ISO/IEC 23090-31) and ``.wav`` (a channel an actuator) hold the drives of an array, or with
    `trajectory`, where the probe is over time (`touchfield.medium.trace.read_trace`), a force over time;
    ``.tact`` is for a vest of bHaptics; ``.haptic`` (Meta) and ``.ahap`` (Apple) have one track; ``.html`` is
    the page, with the stream within. `device_name` is a profile, of an array or with `trajectory` of a point:
    by default the device that the stream was made for, and for ``.tact`` a TactSuit X40 where it was made for
    another. `panel` is that of an array, "front" or "back"; `against`, of the page, what was encoded;
    `full_scale_n`, of a force as ``.hjif``, are the newtons that are told as 1; 1 tells newtons.
    TouchfieldError if anything is at fault; nothing is then left under the name `out`.
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
    with open_stream(stream) as opened:
        if kind == ".html":
            head, page = opened.reader.head, view(stream, against, report)
            page.save(path)
            figures = {"frames": head.frame_count}
            figures |= {key: page.figures[key] for key in ("source_bytes",) if key in page.figures}
            return _exported(path, head.device_name, head.frame_count / head.rate_hz, figures)
        if trajectory is not None:
            return _export_force(opened, path, kind, device_name, trajectory, full_scale_n)
        return _export_array(opened, path, kind, device_name, panel, report)


def import_effect(
    source: str | Path,
    out: str | Path,
    spec: EncodeSpec | None = None,
    rate_hz: float = DEFAULT_RATE_HZ,
    force_max_n: float | None = None,
    report: Report = silent,
) -> Encoded:
    """Turn an effect of others into a ``.touch`` file: a symbolic medium for an array of actuators.

    A stream keeps a drive as exactly as its coder is asked to keep the force, and beside it the frequency in
    whole hertz with the drive to within a ninth (`touchfield.codec.vibration`); what is shown is the greater
    of the two. `source` is ``.hjif``, ``.hmpg`` (its binary form) or ``.ahap``; of `spec` are taken the
    coder, its haptic filters, frames and vibration in place of the effect's own; the device is that of the
    effect. `rate_hz` are the frames a second, and `force_max_n` the force that a full drive stands for: None
    takes what the file tells, or else 3.3 N. TouchfieldError if anything is at fault; nothing is then left
    under the name `out`.
    """
    asked = spec or EncodeSpec()
    if force_max_n is not None and not 0 < force_max_n <= 1e6:
        raise InvalidArgument("force_max_n", repr(force_max_n), "newtons above 0, up to a million")
    kind = Path(source).suffix.lower()
    require_ending(source, *IMPORTS)
    require_ending(out, "OUT.touch")
    pattern = (read_ahap if kind == ".ahap" else read_hjif_array)(source, rate_hz)
    full_n = pattern.force_max_n if force_max_n is None else force_max_n
    own = effect_device(pattern.effect.lattice, pattern.device_name, full_n)
    symbolic = effect_medium(pattern.effect, device_grid(own), own.force_max_n, {"format": kind[1:]})
    prepared = prepare(KeptScene(symbolic, own, pattern.notes), replace(asked, device=own.name, nw=None))
    prepared = replace(prepared, reference=FILTERED)
    return encode_prepared(prepared, out, provenance_of(source, prepared), report)


def _exported(
    path: Path, device_name: str, seconds: float, figures: dict[str, Any], notes: tuple[str, ...] = ()
) -> Result:
    size = path.stat().st_size
    return Result({"file_bytes": size, "device": device_name, "seconds": seconds, **figures}, notes)


def _export_array(
    stream: OpenStream, path: Path, kind: str, device_name: str | None, panel: str, report: Report
) -> Result:
    require_one_of("panel", panel, PANELS)
    chosen = _array(stream, kind, device_name)
    # a back that the profile does not count is a front worn behind
    drives = array_drives(stream, chosen, panel if chosen.panels > 1 else PANELS[0])
    columns, rows, _ = chosen.lattice
    checked_frames("stream", len(drives), columns * rows, MAX_MEDIUM_VALUES)
    nth = PANELS.index(panel) if chosen.panels > 1 else 0
    shown, hertz = np.zeros((len(drives), rows, columns), np.float32), None
    for i in range(len(drives)):
        shown[i] = drives.drives(i)[nth]
        own = drives.frequencies(i)
        if own is not None:
            hertz = np.zeros_like(shown) if hertz is None else hertz
            hertz[i] = own[nth]
        report(i + 1, len(drives))
    effect = ArrayEffect(drives.rate_hz, shown, hertz)
    notes: tuple[str, ...] = ()
    title = f"{Path(stream.reader.provenance.get('source', '')).name or 'a stream'} for {chosen.name}"
    if kind == ".tact":
        write_tact(path, effect, panel=panel)
        if effect.frequencies_hz is not None:
            notes = ("The frequencies are left out: a vest of bHaptics has none.",)
    elif kind == ".wav":
        notes = write_wav_array(path, effect)
    elif kind == ".hjif":
        write_hjif_array(path, effect, chosen.name, panel=panel, description=title)
    else:
        notes = (write_ahap if kind == ".ahap" else write_haptic)(path, effect, path.stem, title)
    figures = {
        "columns": columns,
        "rows": rows,
        "panel": panel,
        "frames": len(effect),
        "rate_hz": effect.rate_hz,
    }
    if "height" in (chosen.shows, stream_device(stream).shows):
        notes = (
            *notes,
            f"{kind} knows no pins: who reads it takes the heights of a pin display for vibration.",
        )
    if not effect.drives.any():
        notes = (*notes, "Nothing can be felt: no actuator is driven.")
    return _exported(path, chosen.name, len(effect) / effect.rate_hz, figures, notes)


def _array(stream: OpenStream, kind: str, device_name: str | None) -> Device:
    """The array that was asked for; else the stream's own; of a vest else the usual one."""
    if device_name is not None:
        return device(device_name)
    head = stream.reader.head
    columns, rows, depth = head.grid_shape
    own = (
        effect_device((columns, rows, depth), head.device_name, head.force_max_n)
        if head.device_type == 2
        else None
    )
    if kind == ".tact":
        return own if own is not None and fits_vest(own.lattice) else device(_VEST)
    if own is None:
        mend = "Name an array with --device, or a trajectory for the force along it."
        raise InvalidArgument(
            "device", f"a stream for {head.device_name}, a point", "an array of actuators", mend
        )
    return own


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
        chosen = device(device_name)
        if chosen.is_array:
            raise InvalidArgument("device", f"{chosen.name}, an array", "a point (type 1) with a trajectory")
        name, peak_n = chosen.name, chosen.force_max_n
    trace = read_trace(trajectory)
    timescale = WAV_RATE_HZ if kind == ".wav" else _ticks_per_second(trace)
    if trace.times_s[-1] * timescale > _MOST_SAMPLES:
        most = f"at most {_MOST_SAMPLES / timescale:g} s"
        raise InvalidArgument("trajectory", f"{trace.times_s[-1]:g} s", most, "Cut it.")
    times_s = np.arange(max(1, math.floor(trace.times_s[-1] * timescale + 1e-6) + 1)) / timescale
    places_m = np.stack([np.interp(times_s, trace.times_s, of) for of in trace.positions_m.T], axis=1)
    field_n = FieldSampler(stream.scene or stream.medium).force_n(times_s, places_m).astype(np.float64)
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
        share = float(np.mean(magnitude_n > peak_n))
        notes = (f"{100 * share:.3g} % of the samples exceed {peak_n:g} N and are shortened to it.", *notes)
    if not forces_n.any():
        notes = ("Nothing can be felt: the trajectory meets no force.",)
    greatest_n = float(np.linalg.norm(forces_n, axis=1).max())
    figures: dict[str, Any] = {"samples": len(times_s), "ticks_per_second": timescale}
    figures |= {"force_max_n": peak_n, "greatest_n": greatest_n}
    return _exported(path, name, float(times_s[-1]), figures, notes)


def _ticks_per_second(trace: Trace) -> int:
    """A thousand, fewer where so many would not go into one effect."""
    seconds = float(trace.times_s[-1])
    wanted = min(round(HAPTIC_RATE_HZ), math.floor(MAX_SPAN_TICKS / max(seconds, 1.0)))
    if wanted < 1:
        raise InvalidArgument("trajectory", f"{seconds:g} s", f"at most {MAX_SPAN_TICKS} s", "Cut it.")
    return wanted
