"""Compares the coding of force traces and of vibration with the codecs of two standards.

    python bench/bench_traces.py [--quick] [--signals FOLDER]

"force": three axes of force over time, the six recordings of a hand that guides a robot (about 700 samples
per second; skipped without the optional folder of inputs). The peer is the deadband of IEEE 1918.1.1 (its
principle, not its reference software): a sample is sent when it differs from the last one sent by more than
k = 0.1 of that one's length, and is held until the next. "deadband" is the payload of what is sent, 3 x 16
bits a packet without headers; "deadband_mask" sends when the error bound max(0.05 N, 0.1 |F|) would be
exceeded; "deadband_xz" is the file of the latter (intervals and steps of 1 mN, compressed by xz). "stored" is
coder `touch` with the same bound, half a second of samples as one row of its lattice; "ticks" is the same
coder with one sample a frame, which is what a live stream would send, of the first 2 s.

"vibration": signals that MPEG's reference encoder was evaluated on. FOLDER has them by MPEG's names, such as
ACTK-vib-pantheongrandstarfall-8kHz-16-nopad.wav (one channel, 8 kHz, 16 bits); `touchfield data show
mpeg-haptics` says where they are. Without --signals, the folder mpeg-haptics of the optional inputs is used.
The stored result names the signals that were not there; they have no figure. A row is a point of MPEG's own
tables: bit rate and PSNR (peak to peak 2) of the reference codec at a target rate. There are two tables, of
two states of that codec; both are used, since either may be the better one.

`reduce_vibration` is run with the smallest full scale that reaches this PSNR. "xz" is the size of its symbols
compressed by xz, which a decoder can read, and "estimate" the code length that the reduction states. "pcm_xz"
is the trivial codec: samples rounded to the coarsest step that reaches this PSNR, or their differences if
these are shorter, by xz. It, too, needs fewer bits than MPEG's tables, which are therefore a weak peer for
storage: the reference encoder codes one short block after the other, and xz sees the whole signal. Equal PSNR
is not equal sensation: `reduce_vibration` bounds the error by a hand's threshold, and MPEG's codec weights it
by a model of its own.
"""

from __future__ import annotations

import lzma
import sys
from pathlib import Path
from typing import Any

import numpy as np

import touchfield as tf
from machine import SHARED, Bar, Figures, at_least, at_most, bench, column
from touchfield.arrays import Float32s, Float64s
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.perception.vibrotactile import ReducedVibration, reduce_vibration
from touchfield.sources.recordings.recording import read_recording

RECORDED = SHARED / "force_panda_comanipulation" / "symbol_data.mat"
RATE_HZ, K, F0_N = 700.0, 0.1, 0.05
PACKET_BITS = 3 * 16
STEP_N = 1e-3
ROW = 350  # samples of half a second
TICKS = 1400
MPEG_POINTS = {
    "ACTK-vib-pantheongrandstarfall": (
        *((8.050, 31.259), (11.602, 43.337), (16.765, 51.217), (47.951, 53.239)),
        (15.170, 46.247),
    ),
    "Rain": ((7.732, 22.753), (11.137, 37.309), (14.305, 46.864), (31.906, 50.871), (13.080, 42.226)),
    "Rain_chan2": ((8.650, 23.469), (12.056, 38.037), (14.896, 48.053), (32.750, 53.174), (13.328, 44.632)),
    "Towel": ((7.494, 31.848), (9.922, 38.960), (17.768, 44.713), (69.422, 52.632), (16.442, 36.427)),
    "HeartBeat": ((8.613, 22.235), (9.680, 37.754), (11.245, 48.666), (17.768, 51.930), (9.683, 48.592)),
    "Paper": ((7.408, 34.608), (14.168, 39.537), (31.374, 46.050), (84.930, 51.266), (29.190, 35.778)),
}
"""kbit/s and dB of bitratePSNR.csv of the reference software: 2, 8, 16 and 64 kbit/s of its commit a216e05,
and 16 kbit/s of 27f9bab. The effects are those of sets 1_2 that are .wav and in both."""
FULL_SCALES_N = tuple(float(2 ** (n / 4)) for n in range(-32, 33))
FINEST_PCM = 2.0**-14
HINT = "To measure them: --signals FOLDER with MPEG's files, such as IDCC-vib-Rain-8kHz-16-nopad.wav (8 kHz)"


# -- force -------------------------------------------------------------------------------------------------


def deadband(forces_n: Float64s, k: float, floor_n: float = 0.0, *, is_bound: bool = False) -> Any:
    """Return the held signal, newtons [n, 3], and whether each sample is sent.

    A sample is sent if it is farther from the last one sent than `k` times the length of that one, or with
    `is_bound` than max(`floor_n`, `k` times its own length).
    """
    held, is_sent = np.empty_like(forces_n), np.zeros(len(forces_n), bool)
    last = forces_n[0]
    for n, force in enumerate(forces_n):
        limit = max(floor_n, k * float(np.linalg.norm(force))) if is_bound else k * np.linalg.norm(last)
        if n == 0 or np.linalg.norm(force - last) > limit:
            last, is_sent[n] = force, True
        held[n] = last
    return held, is_sent


def packed_bytes(held_n: Float64s, is_sent: Any) -> int:
    """Return the bytes of a file of what is sent: intervals and differences in steps of 1 mN, by xz."""
    steps = np.rint(held_n[is_sent] / STEP_N).astype(np.int32)
    intervals = np.diff(np.flatnonzero(is_sent), prepend=0).astype("<u2")
    deltas = np.diff(steps, axis=0, prepend=0).astype("<i2")
    planes = np.concatenate([intervals, *deltas.T.view("<u2")]).view(np.uint8).reshape(-1, 2).T
    return len(_xz(planes.tobytes()))


def _xz(data: bytes) -> bytes:
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME}]
    return lzma.compress(data, lzma.FORMAT_RAW, filters=filters)


def touch_rows(forces_n: Float32s, row: int) -> tuple[int, Float64s]:
    """Return bytes and decoded forces of coder `touch`, `row` samples as one frame of its own segment."""
    grid = tf.Grid((row, 1, 1), (0.01,) * 3, (0.0,) * 3)
    encoder = TouchEncoder(grid, TouchSpec(k=K, f0_n=F0_N, effort="fast"))
    decoder = TouchDecoder(grid, encoder.parameters)
    total, parts = 0, []
    for start in range(0, len(forces_n), row):
        part = forces_n[start : start + row]
        dense = np.zeros((row, 3), np.float32)
        dense[: len(part)] = part
        body = encoder.encode_segment([tf.ForceField.from_dense(grid, dense[:, None, None])]).body
        total += len(body)
        parts.append(next(iter(decoder.frames(body, 1))).to_dense().reshape(-1, 3)[: len(part)])
    return total, np.concatenate(parts).astype(np.float64)


def touch_ticks(forces_n: Float32s) -> int:
    """Return the bytes of coder `touch` with a frame for each sample, segments of half a second."""
    grid = tf.Grid((1, 1, 1), (0.01,) * 3, (0.0,) * 3)
    encoder = TouchEncoder(grid, TouchSpec(k=K, f0_n=F0_N, effort="fast"))
    frames = [tf.ForceField.from_dense(grid, force[None, None, None]) for force in forces_n]
    return sum(
        len(encoder.encode_segment(frames[start : start + ROW]).body) for start in range(0, len(frames), ROW)
    )


def _worst(forces_n: Float64s, decoded_n: Float64s) -> float:
    """Return the largest error in units of max(F_0, k |F|)."""
    limits = np.maximum(F0_N, K * np.linalg.norm(forces_n, axis=1))
    return float((np.linalg.norm(decoded_n - forces_n, axis=1) / limits).max())


def _snr_db(signal: Float64s, decoded: Float64s) -> float:
    return float(20 * np.log10(np.linalg.norm(signal) / np.linalg.norm(decoded - signal)))


def force(forces_n: Float64s) -> Figures:
    """Return rates and errors of one recording."""
    seconds = len(forces_n) / RATE_HZ
    held, is_sent = deadband(forces_n, K)
    bounded, is_bounded_sent = deadband(forces_n, K, F0_N, is_bound=True)
    stored_bytes, stored = touch_rows(forces_n.astype(np.float32), ROW)
    ticks = forces_n[:TICKS].astype(np.float32)
    return {
        "packets_per_s": float(is_sent.sum() / seconds),
        "deadband_kbit_s": PACKET_BITS * float(is_sent.sum()) / seconds / 1e3,
        "deadband_snr_db": _snr_db(forces_n, held),
        "mask_packets_per_s": float(is_bounded_sent.sum() / seconds),
        "deadband_mask_kbit_s": PACKET_BITS * float(is_bounded_sent.sum()) / seconds / 1e3,
        "deadband_xz_kbit_s": 8 * packed_bytes(bounded, is_bounded_sent) / seconds / 1e3,
        "deadband_mask_snr_db": _snr_db(forces_n, bounded),
        "deadband_mask_worst": _worst(forces_n, bounded),
        "stored_kbit_s": 8 * stored_bytes / seconds / 1e3,
        "stored_snr_db": _snr_db(forces_n, stored),
        "stored_worst": _worst(forces_n, stored),
        "ticks_kbit_s": 8 * touch_ticks(ticks) / (len(ticks) / RATE_HZ) / 1e3,
    }


def recordings(count: int) -> Figures:
    """Return the figures of the recordings; empty without the folder of inputs."""
    if not RECORDED.exists():
        return {}
    from scipy.io import loadmat

    rows = loadmat(RECORDED, squeeze_me=True, struct_as_record=False)["symbol_data"]
    return {f"recording {n}": force(row.F.T.astype(np.float64)) for n, row in enumerate(rows[:count])}


# -- vibration ---------------------------------------------------------------------------------------------


def _psnr_db(signal: Float64s, decoded: Float64s) -> float:
    return float(10 * np.log10(4 / np.mean((decoded - signal) ** 2)))


def _reduced_at(signal: Float64s, rate_hz: float, full_scale_n: float) -> tuple[ReducedVibration, float]:
    reduced = reduce_vibration(full_scale_n * signal, rate_hz)
    return reduced, _psnr_db(signal, reduced.decoded() / full_scale_n)


def _xz_bits(reduced: ReducedVibration) -> int:
    """Return the bits of symbols and steps, frequencies one after the other, compressed by xz."""
    symbols = np.ascontiguousarray(reduced.symbols.T.astype("<i2"))
    planes = symbols.view(np.uint8).reshape(-1, 2).T
    return 8 * (len(_xz(planes.tobytes())) + 2 * len(reduced.exponents))


def _pcm_bits(signal: Float64s, psnr_db: float) -> int:
    """Return the bits of samples, or of their differences, at the coarsest step that reaches `psnr_db`."""
    step = 4 * np.sqrt(12 / 10 ** (psnr_db / 10))
    while _psnr_db(signal, step * np.rint(signal / step)) < psnr_db and step > FINEST_PCM:
        step *= 0.98
    levels = np.rint(signal / step).astype("<i2")
    coded = [levels, np.diff(levels, prepend=0).astype("<i2")]
    return 8 * min(len(_xz(each.view(np.uint8).reshape(-1, 2).T.tobytes())) for each in coded)


def point(signal: Float64s, rate_hz: float, mpeg_kbit_s: float, mpeg_psnr_db: float) -> Figures:
    """Return the figures of the reduction and of PCM at the PSNR of a point of MPEG's tables."""
    seconds = len(signal) / rate_hz
    for full_scale_n in FULL_SCALES_N:
        reduced, psnr_db = _reduced_at(signal, rate_hz, full_scale_n)
        if psnr_db >= mpeg_psnr_db:
            break
    return {
        "mpeg_kbit_s": mpeg_kbit_s,
        "mpeg_psnr_db": mpeg_psnr_db,
        "pcm_xz_kbit_s": _pcm_bits(signal, mpeg_psnr_db) / seconds / 1e3,
        "xz_kbit_s": _xz_bits(reduced) / seconds / 1e3,
        "estimate_kbit_s": reduced.bits_per_s / 1e3,
        "psnr_db": psnr_db,
        "full_scale_n": full_scale_n,
    }


def vibration(folder: Path, points: int) -> tuple[Figures, str]:
    """Return a row for each of the first `points` of a signal in `folder`, and what had no figure and why."""
    rows, missing = {}, []
    for name, mpeg in MPEG_POINTS.items():
        files = sorted(folder.glob(f"*{name}-8kHz*.wav"))
        if not files:
            missing.append(f"{name} (no such file)")
            continue
        recording = read_recording(files[0], 1.0)
        if recording.acceleration_m_s2[:, 1:].any():
            missing.append(f"{name} (several channels; MPEG's tables do not say how they count)")
            continue
        signal = np.asarray(recording.acceleration_m_s2[:, 0])
        for kbit_s, psnr_db in mpeg[:points]:
            rows[f"{name}, {psnr_db:.1f} dB"] = point(signal, recording.rate_hz, kbit_s, psnr_db)
    return rows, f"{', '.join(missing)}. {HINT}" if missing else "none"


def signals_folder(signals: str) -> Path:
    """Return the folder of MPEG's signals; SystemExit if the one named is none."""
    if signals and not Path(signals).is_dir():
        sys.exit(f"--signals {signals}: no such folder. {HINT}")
    return Path(signals) if signals else SHARED / "mpeg-haptics"


def measure(count: int, points: int, signals: str) -> Figures:
    """Measure the coding of forces and of the vibration."""
    rows, missing = vibration(signals_folder(signals), points)
    return {"force": recordings(count), "vibration": rows, "signals without a figure": missing}


def bars(figures: Figures) -> list[Bar]:
    """Require the error bound, and fewer bits than the peers where all know the same."""
    rows = figures["force"]
    ratios = [row["deadband_xz_kbit_s"] / row["stored_kbit_s"] for row in rows.values()]
    vibrated = figures["vibration"].values()
    over = [row["psnr_db"] - row["mpeg_psnr_db"] for row in vibrated]
    mpeg = [row["mpeg_kbit_s"] / row["xz_kbit_s"] for row in vibrated]
    pcm = [row["pcm_xz_kbit_s"] / row["xz_kbit_s"] for row in vibrated]
    return [
        at_most("largest error over the bound, stored", max(column(rows, "stored_worst"), default=None), 1.0),
        at_most(
            "the same, deadband with this bound", max(column(rows, "deadband_mask_worst"), default=None), 1.0
        ),
        at_least("deadband file over stored bytes", min(ratios, default=None), 1.5),
        at_least("PSNR of the vibration over MPEG's, least", min(over, default=None), 0.0, "dB"),
        at_least("MPEG's bits over those by xz, least", min(mpeg, default=None), 2.0),
        at_least("bits of PCM by xz over those by xz, least", min(pcm, default=None), 1.5),
    ]


if __name__ == "__main__":
    bench("traces", __doc__, measure, bars, count=(6, 1), points=(5, 1), signals=("", ""))
