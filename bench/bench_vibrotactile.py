"""Measures vibration (paper section 6.4): accuracy of its splitting from force, its reduction, and rendered
textures.

    python bench/bench_vibrotactile.py [--quick] [--seconds S]

"laws": errors of three exact operations on random signals: the crossover into low and high frequencies,
DFT321 (three axes to one), and the STFT and its inverse.

"reduction": a vibration of one axis is reduced to what can be felt. "recordings" are the forces of a hand
that guides a robot (six, about 700 samples per second; skipped without the optional folder of inputs), split
at 30 Hz; the high part is mapped to one axis. The synthetic signals of `--seconds` at 2 kHz are noise like a
rough surface, ridges, and taps. The bits are those of an adaptive code, compared with 16 bits per sample of
one axis. The margin is the distance of the error below the threshold of a hand that holds a stylus, in the
worst third of an octave and half second. It is computed by `third_octave_power`, which the reduction does not
use.

"slide": a simulated hand slides over a wall with a texture table of three speeds and two forces. The figures
are the deviation of the device's force from the table in thirds of an octave, and the time of a tick with and
without the texture.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import resample_poly

import touchfield as tf
from machine import SHARED, Bar, Figures, at_least, at_most, bench, column, figure
from touchfield.devices import device
from touchfield.devices.drivers.registry import point_device
from touchfield.medium.trace import Trace
from touchfield.perception.hand_motion import third_octave_power
from touchfield.perception.human import vibration_threshold
from touchfield.perception.vibrotactile import BANDS_HZ, Crossover, Stft, band_rms, dft321, reduce_vibration
from touchfield.render.material import Material
from touchfield.render.offline import run_offline
from touchfield.render.spec import RenderSpec

RECORDED = SHARED / "force_panda_comanipulation" / "symbol_data.mat"
RECORDED_HZ, SYNTHETIC_HZ, LOOP_HZ = 700.0, 2000.0, 2500.0
GRID = tf.Grid((65, 33, 33), (0.005,) * 3, (-0.16, -0.08, -0.08))


def laws(seconds: float) -> Figures:
    """Return the worst errors of crossover, DFT321 and STFT over ten signals."""
    worst = {"crossover": 0.0, "dft321": 0.0, "stft_db": np.inf}
    for seed in range(10):
        signal = (
            np.random.default_rng(seed).normal(size=(int(seconds * SYNTHETIC_HZ) + seed, 3)).cumsum(axis=0)
        )
        low, high = Crossover(SYNTHETIC_HZ).split(signal)
        spectrum = (np.abs(np.fft.rfft(high, axis=0)) ** 2).sum(axis=1)
        vibration = dft321(high)
        energy = np.abs(np.abs(np.fft.rfft(vibration)) ** 2 - spectrum) / np.maximum(
            spectrum, 1e-9 * spectrum.max()
        )
        stft = Stft()
        residual = np.linalg.norm(stft.signal_from(stft.real_spectra(vibration), len(vibration)) - vibration)
        worst["crossover"] = max(
            worst["crossover"], float(np.abs(low + high - signal).max() / np.abs(signal).max())
        )
        worst["dft321"] = max(worst["dft321"], float(energy.max()))
        worst["stft_db"] = min(worst["stft_db"], float(20 * np.log10(np.linalg.norm(vibration) / residual)))
    return worst


def recordings() -> dict[str, Any]:
    """Return one axis of the high part of each recorded force.

    Empty without the folder of inputs.
    """
    if not RECORDED.exists():
        return {}
    from scipy.io import loadmat

    rows = loadmat(RECORDED, squeeze_me=True, struct_as_record=False)["symbol_data"]
    return {f"recording {n}": dft321(Crossover(RECORDED_HZ).split(row.F.T)[1]) for n, row in enumerate(rows)}


def synthetic(seconds: float) -> dict[str, Any]:
    """Return vibrations of one axis, newtons, at `SYNTHETIC_HZ`."""
    rng, t = np.random.default_rng(6), np.arange(int(seconds * SYNTHETIC_HZ)) / SYNTHETIC_HZ
    rough = np.convolve(rng.normal(size=len(t) + 31), np.hanning(32) * np.cos(0.6 * np.arange(32)), "valid")
    hits = np.exp(-((t * 40) % 1) * 8) * np.sin(2 * np.pi * 180 * t) * (1 + 0.2 * rng.normal(size=len(t)))
    tap = np.exp(-(t % 1) * 60) * np.sin(2 * np.pi * 220 * t)
    return {"rough": 0.03 * rough / rough.std(), "ridges": 0.2 * hits, "taps": 0.5 * tap}


def margin_db(error: Any, rate_hz: float) -> float:
    """Return the least distance to the threshold, dB, over thirds and half seconds."""
    if rate_hz < 1000:  # third_octave_power needs at least 1 kHz
        error, rate_hz = resample_poly(error, 2, 1), 2 * rate_hz
    length = int(rate_hz / 2)
    windows = [error[a : a + length] for a in range(0, len(error) - length + 1, length // 2)]
    power = [third_octave_power(np.stack([w, 0 * w, 0 * w], axis=1), rate_hz) for w in windows]
    limit_mn, level_mn = vibration_threshold().force_rms_mn(), 1e3 * np.sqrt(np.max(power, axis=0))
    return float(np.min(20 * np.log10(limit_mn / np.maximum(level_mn, 1e-12))))


def reduction(signals: dict[str, Any], rate_hz: float) -> Figures:
    """Return bits and margin of each signal."""
    rows = {}
    for name, signal in signals.items():
        began = time.perf_counter()
        sent = reduce_vibration(signal, rate_hz)
        took = time.perf_counter() - began
        rows[name] = {
            "rms_mn": 1e3 * float(np.sqrt((signal**2).mean())),
            "kbit_s": sent.bits_per_s / 1e3,
            "of_pcm": 16 * len(signal) / sent.bits,
            "margin_db": margin_db(signal - sent.decoded(), rate_hz),
            "times_real": len(signal) / rate_hz / took,
        }
    return rows


def slides() -> Figures:
    """Slide over a texture table of three speeds, at these speeds and between two."""
    force = np.zeros((1, *GRID.shape, 3))
    force[..., 2] = np.maximum(-300.0 * (GRID.origin_m[2] + GRID.spacing_m[2] * np.arange(GRID.shape[2])), 0)
    medium = tf.HapticMedium.from_array(force, GRID, 30.0)
    profile = replace(device("phantom-omni"), force_max_n=40.0, force_continuous_n=None)
    levels = (
        0.004
        * np.exp(0.5 * np.random.default_rng(3).normal(size=(3, 2, 16)))
        * np.arange(1, 4)[:, None, None]
    )
    table = Material("oak", speeds_m_s=(0.03, 0.06, 0.12), forces_n=(0.5, 2.0), texture_rms_n=levels.tolist())
    spec, rows = RenderSpec(render="field", rate_hz=LOOP_HZ, materials=(table,)), {}
    for speed in (0.03, 0.06, 0.09, 0.12):
        at = np.array([[-0.14, 0, -0.0025], [-0.14, 0, -0.0025], [0.14, 0, -0.0025]])
        seconds = 0.1 + 0.28 / speed
        opener = point_device("sim", Trace(np.array([0, 0.1, seconds]), at)).opener
        run_offline(medium, profile, opener, spec, seconds=0.05)  # compile and load the kernels
        took = []
        for run_spec in (spec, replace(spec, materials=())):
            began = time.perf_counter()
            run = run_offline(medium, profile, opener, run_spec, seconds=seconds)
            took.append(1e6 * (time.perf_counter() - began) / len(run.log))
            if run_spec is spec:
                force_n = run.log["force_n"][int(0.25 * LOOP_HZ) : int((seconds - 0.01) * LOOP_HZ), 2].astype(
                    float
                )
        weight = (300.0 * 0.0025 - 0.5) / 1.5
        pressed = (1 - weight) * levels[:, 0] + weight * levels[:, 1]
        expected = np.array([np.interp(speed, table.speeds_m_s, pressed[:, b]) for b in range(len(BANDS_HZ))])
        off = np.abs(20 * np.log10(band_rms(force_n - force_n.mean(), LOOP_HZ) / expected))
        rows[f"{1e3 * speed:g} mm/s"] = {
            "worst_db": float(off.max()),
            "tick_us": took[0],
            "without_us": took[1],
        }
    return rows


def measure(seconds: float) -> Figures:
    """Measure exact operations, reduction and slides."""
    reduction_rows = reduction(recordings(), RECORDED_HZ) | reduction(synthetic(seconds), SYNTHETIC_HZ)
    slide_rows = slides()
    return {
        "laws": laws(seconds),
        "reduction": reduction_rows,
        "slide": slide_rows,
        "tick_more_us": float(np.median([row["tick_us"] - row["without_us"] for row in slide_rows.values()])),
    }


def bars(figures: Figures) -> list[Bar]:
    """Require exact operations, errors below the threshold, few bits, accurate textures."""
    rows = figures["reduction"]
    real = {name: row for name, row in rows.items() if name.startswith("recording")}
    return [
        at_most("low and high less the signal, share of it", figure(figures, "laws", "crossover"), 1e-12),
        at_most("DFT321, energy of a bin", figure(figures, "laws", "dft321"), 1e-12),
        at_least("spectra and back", figure(figures, "laws", "stft_db"), 100.0, "dB"),
        at_least("what is lost below the threshold", min(column(rows, "margin_db"), default=None), 0.0, "dB"),
        at_least(
            "16 bits a sample over what is sent, made", min(column(synthetic_rows(rows), "of_pcm")), 4.0
        ),
        at_least("the same, recorded", min(column(real, "of_pcm"), default=None), 4.0),
        at_least("seconds reduced in a second", min(column(rows, "times_real")), 10.0),
        at_most("thirds of a slide from the table", max(column(figures["slide"], "worst_db")), 1.0, "dB"),
        at_most("a tick longer with a material", figure(figures, "tick_more_us"), 5.0, "us"),
    ]


def synthetic_rows(rows: Figures) -> Figures:
    """Return the rows of synthetic signals."""
    return {name: row for name, row in rows.items() if not name.startswith("recording")}


if __name__ == "__main__":
    bench("vibrotactile", __doc__, measure, bars, seconds=(8.0, 2.0))
