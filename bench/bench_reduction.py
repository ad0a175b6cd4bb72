"""Measures the reduction of a medium (paper section 6.1): modes, their bytes, and removal of samples out of
reach.

    python bench/bench_reduction.py [--quick] [--frames N] [--paths N]

"modes": the media are a skinned fox and a morph target (skipped without the optional folder of inputs), and
falling bodies. Modes are learnt from the even frames, as many as represent the odd frames at -30 dB. "share"
is the amount of numbers that a receiver needs for coefficients and modes, relative to the medium without
modes; "share of coefficients" leaves out the modes. "kb" are the bytes of the modes as 16-bit floats and of
the rounded coefficients, both compressed by LZMA. LZMA is no coder made for them, but shows the order of
magnitude. "touch kb" are the bytes of the same frames by coder `touch` at about the same error.

"culling": the media are a static solid pillow (`thickness_m` inf), a solid floor with a travelling wave, and
a solid box. Nothing of the box is removed: at its edges forces turn by a right angle from one sample to the
next, and nothing is proved to stop a hand there. The figures are the samples that remain after samples out of
the hand's reach are removed, and the forces that differ along `--paths` adversarial paths of hands. These
press against the force, swing with it so that each turn gains energy, or approach from far away.
"""

from __future__ import annotations

import lzma
import tempfile
import time
from pathlib import Path

import numpy as np

import touchfield as tf
from machine import SHARED, Bar, Figures, at_least, at_most, bench, figure
from touchfield.measure.fidelity import FidelityMeter
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import ReductionSpec
from touchfield.reduction import Hand, ReducedMedium, freedom, held_out, reach_of, reduce_to_modes
from touchfield.tasks.reduction import hand_of, without_unreachable

HAND = hand_of(tf.device("phantom-premium-1.5"), ReductionSpec())
PILLOW = """axes = "x right, y up, z towards the viewer"
[[shape]]
kind = "superquadric"
center_m = [0.0, 0.0, 0.0]
half_extents_m = [0.16, 0.12, 0.085]
exponents = [0.5, 0.5]
"""
BOX = """axes = "x right, y up, z towards the viewer"
[[shape]]
kind = "box"
center_m = [0.0, 0.0, 0.0]
half_extents_m = [0.04, 0.04, 0.04]
"""


def media(frames: int) -> dict[str, tuple[tf.HapticMedium, tuple[str, ...]]]:
    """Return the available media, with the kinds of modes to try."""
    meshes, found = SHARED / "meshes", dict[str, tuple[tf.HapticMedium, tuple[str, ...]]]()
    spec = tf.EncodeSpec(nw=6, representation="voxel")
    if (meshes / "fox" / "Fox.glb").exists():
        medium = prepare(meshes / "fox" / "Fox.glb", spec).medium
        found["fox"] = medium[: min(2 * frames, len(medium))], ("global",)
        medium = prepare(meshes / "morph_stress_test" / "MorphStressTest.gltf", spec).medium
        found["morph"] = medium[: min(frames, len(medium))], ("global", "bricks")
    fall = prepare(
        "sample:falling-4", tf.EncodeSpec(nw=6, representation="voxel", frames=(200, 200 + frames))
    ).medium
    return {**found, "fall": (fall, ("bricks",))}


def in_memory(medium: tf.HapticMedium) -> tf.HapticMedium:
    """Return the same medium with its frames in memory."""
    return tf.HapticMedium.from_frames([medium[i] for i in range(len(medium))], medium.rate_hz, medium.axes)


def by_modes_bytes(found: ReducedMedium, min_n: float) -> int:
    """Return the bytes of modes and coefficients of a medium, compressed by LZMA."""
    coefficients = np.concatenate([found.coefficients(i) for i in range(len(found.medium))])
    coefficients[np.abs(coefficients) < min_n] = 0
    step = max(float(np.sqrt((found.modes.energy * 1e-4 * 12) / coefficients.size)), 1e-12)
    parts = (
        found.modes.basis.T.astype(np.float16).tobytes(),
        np.rint(coefficients / step).T.astype(np.int32).tobytes(),
    )
    return sum(len(lzma.compress(part)) for part in parts)


def by_touch(medium: tf.HapticMedium) -> tuple[float, float]:
    """Return kilobytes and NMSE of coder `touch`, at the step expected to give -30 dB."""
    squares = [(field.forces_n.astype(float) ** 2).sum() / max(1, field.support_count) for field in medium]
    coder = tf.codec.TouchSpec(mode="nmse", step_n=2 * float(np.sqrt(1e-3 * np.mean(squares))))
    meter = FidelityMeter(0.1, 0.05)
    with tempfile.TemporaryDirectory() as folder:
        done = tf.encode(medium, Path(folder) / "a.touch", tf.EncodeSpec(touch=coder))
        with tf.open_stream(Path(folder) / "a.touch") as stream:
            for i in range(0, len(medium), 8):
                meter.add(medium[i], stream.medium[i])
    return done.file_bytes / 1e3, float(meter.nmse_db or 0.0)


def modes_of(frames: int) -> Figures:
    """Return held-out error, degrees of freedom and bytes of each medium."""
    rows: Figures = {}
    for name, (source, kinds) in media(frames).items():
        medium = in_memory(source)
        touch_kb, touch_db = by_touch(medium)
        for kind in kinds:
            began = time.perf_counter()
            fit = held_out(medium, kind)
            found = reduce_to_modes(medium, kind, fit.modes)
            free = freedom(found, 0.05)
            rows[f"{name}, {kind}"] = {
                "frames": len(medium),
                "modes": fit.modes,
                "numbers": fit.numbers,
                "nmse_db": fit.nmse_db,
                "share_of_coefficients": fit.share_of_coefficients,
                "share": fit.share,
                "degrees_of_freedom": free.effective,
                "bits_per_coefficient": free.bits,
                "kb": by_modes_bytes(found, fit.min_n) / 1e3,
                "touch_kb": touch_kb,
                "touch_nmse_db": touch_db,
                "seconds": time.perf_counter() - began,
            }
            print(name, kind, rows[f"{name}, {kind}"], flush=True)
    return rows


def pillow() -> tf.HapticMedium:
    """Return a static solid in a box of 381 x 267 x 191 mm."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pillow.toml"
        path.write_text(PILLOW)
        spec = tf.EncodeSpec(
            device="phantom-premium-1.5", nw=7, thickness_m=np.inf, stiffness_n_per_m=1500.0, mapping="1"
        )
        return in_memory(prepare(path, spec).medium)


def box() -> tf.HapticMedium:
    """Return a static solid box of 80 mm."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "box.toml"
        path.write_text(BOX)
        spec = tf.EncodeSpec(
            device="phantom-premium-1.5", nw=6, thickness_m=np.inf, stiffness_n_per_m=1500.0, mapping="1"
        )
        return in_memory(prepare(path, spec).medium)


def floor() -> tf.HapticMedium:
    """Return a solid floor with a travelling wave.

    The wave is 6 mm high, the floor 144 mm wide; 36 frames.
    """
    count, step_m = 48, 0.003
    grid = tf.Grid((count,) * 3, (step_m,) * 3, (0.0,) * 3)
    x = np.stack(np.meshgrid(*[grid.axis_m(a) for a in range(3)], indexing="ij"), axis=-1)
    fields = []
    for i in range(36):
        turn = 2 * np.pi * (x[..., 0] / (count * step_m) - i / 60)
        slope = 0.006 * 2 * np.pi / (count * step_m) * np.cos(turn)
        normal = np.stack([-slope, 0 * slope, 1 + 0 * slope], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        deep = np.maximum(0.11 + 0.006 * np.sin(turn) - x[..., 2], 0) * normal[..., 2]
        fields.append(
            tf.ForceField.from_dense(grid, (np.minimum(1500 * deep, 8)[..., None] * normal).astype("f4"))
        )
    return tf.HapticMedium.from_frames(fields, 60.0)


def paths(
    medium: tf.HapticMedium, shell: tf.HapticMedium, hand: Hand, count: int, ticks: int = 600
) -> Figures:
    """Count the forces that differ along paths of `ticks` ticks of 1 ms."""
    rng, dt, grid = np.random.default_rng(5), 1e-3, medium.grid
    low, high = grid.to_m(np.zeros(3)), grid.to_m(np.array(grid.shape) - 1)
    x = rng.uniform(low, high, (20 * count, 3))
    x = x[~medium[0].sample_n(x).any(axis=1)][:count]
    v = rng.normal(size=x.shape)
    v *= hand.speed_m_s / np.linalg.norm(v, axis=1, keepdims=True)
    differ, max_n, met = 0, 0.0, np.zeros(len(x), bool)
    way = np.arange(len(x)) % 3
    for tick in range(ticks):
        force = medium.sample_n(x, tick * dt)
        differ += int((force != shell.sample_n(x, tick * dt)).any(axis=1).sum())
        size = np.linalg.norm(force, axis=1, keepdims=True).astype(float)
        max_n, met = max(max_n, float(size.max())), met | (size[:, 0] > 0)
        if tick % 200 == 0:
            goal = rng.uniform(low, high, x.shape)
        to_goal = goal - x
        push = np.select([way[:, None] == 0, way[:, None] == 1], [-force, v], to_goal)
        push = np.where(size > 0, push, to_goal)
        push *= hand.push_n / np.maximum(np.linalg.norm(push, axis=1, keepdims=True), 1e-9)
        v = v + dt / hand.mass_kg * (force + push)
        v *= np.minimum(1, hand.speed_m_s / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))
        x = np.clip(x + dt * v, low, high)
    return {"paths": len(x), "in_contact": int(met.sum()), "greatest_n": max_n, "forces_that_differ": differ}


def supported_samples(medium: tf.HapticMedium) -> int:
    """Return the number of supported samples of all frames."""
    return sum(medium[i].support_count for i in range(len(medium)))


def culling(count: int) -> Figures:
    """Return samples, bytes and forces of three solids after culling."""
    rows = {}
    for name, medium in (("pillow", pillow()), ("floor", floor()), ("box", box())):
        began = time.perf_counter()
        reach = reach_of(medium, HAND)
        took = time.perf_counter() - began
        shell = in_memory(without_unreachable(medium, reach.samples))
        before, after = supported_samples(medium), supported_samples(shell)
        exact, sizes = tf.EncodeSpec(touch=tf.codec.TouchSpec(mode="lossless")), []
        with tempfile.TemporaryDirectory() as folder:
            for candidate in (medium, shell):
                sizes.append(tf.encode(candidate, Path(folder) / "a.touch", exact).file_bytes)
        rows[name] = {
            "samples": before,
            "left": after / before,
            "lossless_bytes_left": sizes[1] / sizes[0],
            "stopped_n": reach.stopped_n,
            "seconds": took,
            **paths(medium, shell, HAND, count),
        }
        print(name, rows[name], flush=True)
    return rows


def measure(frames: int, paths: int) -> Figures:
    """Measure culling and modes."""
    return {"hand": HAND.text, "culling": culling(paths), "modes": modes_of(frames)}


def bars(figures: Figures) -> list[Bar]:
    """Require a tenth of the numbers at -30 dB, half of a solid culled, equal forces."""
    rows, solid = figures["modes"], figures["culling"]

    def of(name: str, key: str) -> float | None:
        value: float | None = figure(rows, name, key)
        return value

    found = [
        at_most("fox, global modes: error", of("fox, global", "nmse_db"), -30.0, "dB"),
        at_most("fox, global: coefficients", of("fox, global", "share_of_coefficients"), 0.1),
        at_most("fox, global: with the modes", of("fox, global", "share"), 0.1),
        at_most("morph, global modes: error", of("morph, global", "nmse_db"), -30.0, "dB"),
        at_most("morph, global: coefficients", of("morph, global", "share_of_coefficients"), 0.1),
        at_most("morph, bricks: error", of("morph, bricks", "nmse_db"), -30.0, "dB"),
        at_most("morph, bricks: with the modes", of("morph, bricks", "share"), 0.1),
        at_most("fall, bricks: error", of("fall, bricks", "nmse_db"), -30.0, "dB"),
        at_most("fall, bricks: coefficients", of("fall, bricks", "share_of_coefficients"), 0.1),
    ]
    for name in ("pillow", "floor"):
        found += [
            at_most(f"{name}: samples left", figure(solid, name, "left"), 0.5),
            at_most(f"{name}: forces that differ", figure(solid, name, "forces_that_differ"), 0),
            at_least(f"{name}: paths", figure(solid, name, "paths"), 10_000),
        ]
    return found


if __name__ == "__main__":
    bench("reduction", __doc__, measure, bars, frames=(100, 8), paths=(10_000, 60))
