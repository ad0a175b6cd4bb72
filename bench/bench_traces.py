"""Compares the coding of force traces and of vibration with the codecs of two standards.

    python bench/bench_traces.py [--quick] [--mpeg FILE.wav]

"force": three axes of force over time, the six recordings of a hand that guides a robot (about 700 samples
per second; skipped without the optional folder of inputs). The peer is the deadband of IEEE 1918.1.1 (its
principle, not its reference software): a sample is sent when it differs from the last one sent by more than
k = 0.1 of that one's length, and is held until the next. "deadband" is the payload of what is sent, 3 x 16
bits a packet without headers; "deadband_mask" sends when the error bound max(0.05 N, 0.1 |F|) would be
exceeded; "deadband_xz" is the file of the latter (intervals and steps of 1 mN, compressed by xz). "stored" is
coder `touch` with the same bound, half a second of samples as one row of its lattice; "ticks" is the same
coder with one sample a frame, which is what a live stream would send, of the first 2 s.

"vibration": the signal that MPEG's reference encoder was evaluated on (ACTK-vib-pantheongrandstarfall, 8 kHz;
`touchfield data show mpeg-haptics`; skipped without --mpeg). The reference codec's bit rate and PSNR (peak to
peak 2) at a target of 16 kbit/s are those of MPEG's own table. `reduce_vibration` is run with the full scale
that reaches at least this PSNR; it bounds the error by a hand's threshold, and MPEG's codec weights it by a
model of its own, so that equal PSNR is not equal sensation. "estimate" is the code length that the reduction
states, "xz" the size of its symbols compressed by xz, which a decoder can read.
"""

from __future__ import annotations

import lzma
from pathlib import Path
from typing import Any

import numpy as np

import touchfield as tf
from machine import SHARED, Bar, Figures, at_least, at_most, bench, column, figure
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
MPEG_KBIT_S, MPEG_PSNR_DB = 15.170, 46.247  # of bitratePSNR.csv, 16 kbit/s, WAV
FULL_SCALES_N = tuple(float(2 ** (n / 4)) for n in range(-12, 17))


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


def vibration(path: Path | None) -> Figures:
    """Return bit rate and PSNR of the reduction and of MPEG's reference codec; empty without a file."""
    if path is None:
        return {}
    recording = read_recording(path, 1.0)
    signal = np.asarray(recording.acceleration_m_s2[:, 0])
    for full_scale_n in FULL_SCALES_N:
        reduced, psnr_db = _reduced_at(signal, recording.rate_hz, full_scale_n)
        if psnr_db >= MPEG_PSNR_DB:
            break
    seconds = len(signal) / recording.rate_hz
    return {
        "mpeg_kbit_s": MPEG_KBIT_S,
        "mpeg_psnr_db": MPEG_PSNR_DB,
        "estimate_kbit_s": reduced.bits_per_s / 1e3,
        "xz_kbit_s": _xz_bits(reduced) / seconds / 1e3,
        "psnr_db": psnr_db,
        "full_scale_n": full_scale_n,
        "samples": len(signal),
    }


def measure(count: int, mpeg: str) -> Figures:
    """Measure the coding of forces and of the vibration."""
    return {"force": recordings(count), "vibration": vibration(Path(mpeg) if mpeg else None)}


def bars(figures: Figures) -> list[Bar]:
    """Require the error bound, and fewer bits than the peers where all know the same."""
    rows = figures["force"]
    ratios = [row["deadband_xz_kbit_s"] / row["stored_kbit_s"] for row in rows.values()]
    vibrated = figures["vibration"]
    rate = vibrated and vibrated["mpeg_kbit_s"] / vibrated["xz_kbit_s"]
    return [
        at_most("largest error over the bound, stored", max(column(rows, "stored_worst"), default=None), 1.0),
        at_most(
            "the same, deadband with this bound", max(column(rows, "deadband_mask_worst"), default=None), 1.0
        ),
        at_least("deadband file over stored bytes", min(ratios, default=None), 1.5),
        at_least("PSNR of the vibration", figure(vibrated, "psnr_db"), MPEG_PSNR_DB, "dB"),
        at_least("MPEG's bits over those by xz", rate or None, 2.0),
    ]


if __name__ == "__main__":
    bench("traces", __doc__, measure, bars, count=(6, 1), mpeg=("", ""))
