"""A deformation at the receiver: the map, its force, its tracks, and compliance under a hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from player_makers import Simulated
from tick_makers import OMNI, Bench, points, wall

from gltf_makers import chain_rig
from touchfield import pipeline
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.deformation import STEP_M, Deformation, fitted, read_deformation
from touchfield.render.feeder import FrameSource
from touchfield.render.offline import run_offline
from touchfield.render.sampler import FieldSampler
from touchfield.render.spec import RenderSpec

Float64s = NDArray[np.float64]
GRID = Grid((41, 41, 41), (0.001,) * 3, (-0.02,) * 3)
BOX = (-0.015,) * 3, (0.015,) * 3


def medium(law: object, frames: int = 1, grid: Grid = GRID) -> HapticMedium:
    forces = law(points(grid)).astype(np.float32)  # type: ignore[operator]
    return HapticMedium.from_frames([ForceField.from_dense(grid, forces)] * frames, 50.0)


def ball(p: Float64s) -> Float64s:
    away = np.linalg.norm(p, axis=-1, keepdims=True)
    return np.where(away < 0.012, 400 * (0.012 - away), 0) * p / np.maximum(away, 1e-9)


def spring(p: Float64s) -> Float64s:
    """-grad of a square: linear, so the sampler reproduces it up to float32."""
    return p @ np.array([[80.0, 30, -20], [30, 120, 10], [-20, 10, 60]])


def wavy(frames: int = 1, size_m: float = 0.0006, rate_hz: float = 10.0, controls: int = 8) -> Deformation:
    lattice = Deformation.at_rest(*BOX, controls)
    u = np.random.default_rng(5).normal(size=(frames, controls, controls, controls, 3)) * size_m
    return replace(lattice, displacement_m=u, rate_hz=rate_hz)


def controls_m(lattice: Deformation) -> Float64s:
    """Positions of the control points, [nx, ny, nz, 3]."""
    index = np.stack(
        np.meshgrid(*(np.arange(n) for n in lattice.displacement_m.shape[1:4]), indexing="ij"), axis=-1
    )
    return np.asarray(lattice.corner_m) + (index - 1) * np.asarray(lattice.spacing_m)


def random_points(count: int = 400, reach_m: float = 0.013, seed: int = 1) -> Float64s:
    return np.random.default_rng(seed).uniform(-reach_m, reach_m, (count, 3))


def moved(lattice: Deformation, u: Float64s, p: Float64s) -> Float64s:
    flat, weights = lattice.design(p)
    return np.einsum("nw,nwc->nc", weights, u.reshape(-1, 3)[flat])


# -- the map -----------------------------------------------------------------------------------------------


def test_a_deformation_at_rest_changes_no_bit() -> None:
    base, p = medium(ball), random_points()
    plain, bent = FieldSampler(base), FieldSampler(base, deformation=Deformation.at_rest(*BOX))
    times = np.zeros(len(p))
    for ask in ("force_n", "gradient_n_per_m"):
        found = getattr(bent, ask)(times, p)
        assert found.any() and np.array_equal(found, getattr(plain, ask)(times, p))


def test_an_affine_map_is_exact_and_rotates_forces() -> None:
    lattice = Deformation.at_rest(*BOX)
    a, shift = (
        np.array([[0.1, -0.05, 0.02], [0.03, -0.08, 0.04], [-0.02, 0.06, 0.12]]),
        [0.001, -0.0005, 0.0008],
    )
    bent = replace(lattice, displacement_m=(controls_m(lattice) @ a.T + shift)[None])
    p = random_points(reach_m=0.0149)
    found = FieldSampler(medium(spring), deformation=bent).force_n(np.zeros(len(p)), p).astype(float)
    j = np.eye(3) + a
    expected = spring(p @ j.T + shift) @ j
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    assert bent.min_determinant()[0] == pytest.approx(np.linalg.det(j))
    assert np.linalg.norm(j, 2) <= bent.max_stretch < 1.15 * np.linalg.norm(j, 2)
    for frames in (1, 2):  # a single field is shared by all frames
        sources = [FrameSource(medium(spring, frames), deformation=d) for d in (None, bent)]
        plain, stretched = (max(s.stiffest_n_per_m, s.prepare(0).stiffest_n_per_m) for s in sources)
        assert plain > 0 and stretched == pytest.approx(bent.max_stretch**2 * plain)


def test_force_and_gradient_equal_the_formula() -> None:
    bent, p, t = wavy(3), random_points(), 0.137
    sampler = FieldSampler(medium(spring), deformation=bent)
    u = 0.63 * bent.displacement_m[1] + 0.37 * bent.displacement_m[2]  # 1.37 frames

    def expected(p: Float64s) -> Float64s:
        step = 1e-6 * np.eye(3)
        j = np.stack(
            [(moved(bent, u, p + d) - moved(bent, u, p - d)) / 2e-6 for d in step], axis=-1
        ) + np.eye(3)
        return np.einsum("nki,nk->ni", j, spring(p + moved(bent, u, p)))

    found = np.array([sampler.at(t, *q) for q in p])
    assert found == pytest.approx(expected(p), abs=2e-6)
    slopes = np.stack([(expected(p + d) - expected(p - d)) / 2e-4 for d in 1e-4 * np.eye(3)], axis=-1)
    assert sampler.gradient_n_per_m(t, p) == pytest.approx(slopes, abs=0.02 * np.abs(slopes).max())


def test_a_closed_loop_does_no_work() -> None:
    """A force of unchanged amplitude, the naive choice, would do work."""
    sampler, bent = FieldSampler(medium(spring), deformation=wavy(1, 0.0009)), wavy(1, 0.0009)
    s, weights = np.polynomial.legendre.leggauss(400)
    angle = np.pi * (s + 1)
    loop_m = 0.01 * np.stack([np.cos(angle), np.sin(angle), 0.5 * np.sin(2 * angle)], axis=-1)
    along = 0.01 * np.stack([-np.sin(angle), np.cos(angle), np.cos(2 * angle)], axis=-1)
    # the pieces within a cell, where the spline is one polynomial, are short enough
    force = np.array([sampler.at(0.0, *p) for p in loop_m])
    power = np.einsum("nc,nc->n", force, along)
    scale = float(np.pi * weights @ np.abs(power))
    assert abs(np.pi * weights @ power) < 2e-5 * scale
    amplitude = np.linalg.norm(spring(loop_m + moved(bent, bent.displacement_m[0], loop_m)), axis=1)
    same = np.einsum("nc,nc->n", force / np.linalg.norm(force, axis=1)[:, None] * amplitude[:, None], along)
    assert abs(np.pi * weights @ same) > 1e-3 * scale


def test_the_map_is_constant_and_continuous_outside_the_lattice() -> None:
    bent = wavy(1, 0.0004)
    sampler = FieldSampler(medium(spring), deformation=bent)
    edge = bent.corner_m[0] + bent.spacing_m[0] * 5
    inner, outer = (np.array(sampler.at(0.0, edge + d, 0.002, 0.001)) for d in (-1e-9, 1e-9))
    outside = np.array(sampler.at(0.0, edge + 0.003, 0.002, 0.001))
    u = moved(bent, bent.displacement_m[0], np.array([[edge, 0.002, 0.001]]))[0]
    assert (
        np.linalg.norm(moved(bent, bent.displacement_m[0], np.array([[edge + 0.003, 0.002, 0.001]]))[0] - u)
        < 1e-12
    )
    assert np.isfinite(outside).all() and np.linalg.norm(outer - inner) < 0.5 * np.linalg.norm(inner)
    assert not np.array(sampler.at(0.0, np.nan, 0.0, 0.0)).any()


def test_folds_and_invalid_deformations_are_refused() -> None:
    lattice = Deformation.at_rest(*BOX)
    swap = replace(lattice, displacement_m=(-0.99 * controls_m(lattice))[None])
    assert 0 < swap.min_determinant()[0] < 2e-6
    folded = np.stack([0 * controls_m(lattice), -1.2 * controls_m(lattice) * [1, 0, 0]])
    with pytest.raises(InvalidArgument, match="frame 1: found a fold"):
        replace(lattice, displacement_m=folded)
    for bad, message in (
        ({"displacement_m": np.zeros((1, 3, 8, 8, 3))}, "4 to 32 control points"),
        ({"displacement_m": np.full((1, 8, 8, 8, 3), np.nan)}, "not finite"),
        ({"spacing_m": (0.1, 0.1, 0.0)}, "spacing_m"),
        ({"corner_m": (0.1, 0.1)}, "corner_m"),
        ({"relax_s": 0.0}, "relax_s"),
        ({"displacement_m": np.zeros((50, 32, 32, 32, 3))}, "cells over all frames"),
        ({"compliance_m_per_n": -1.0}, "compliance_m_per_n"),
        ({"displacement_m": swap.displacement_m, "compliance_m_per_n": 0.001}, "bend by their utmost"),
    ):
        with pytest.raises(InvalidArgument, match=message):
            replace(lattice, **bad)  # type: ignore[arg-type]
    largest = replace(lattice, displacement_m=np.zeros((1 << 9, 11, 11, 11, 3)))  # 2^18 cells
    assert len(replace(largest, displacement_m=np.full((1, 4, 4, 4, 3), 0.5))) == 1
    with pytest.raises(InvalidArgument, match="262656 cells over all frames"):
        replace(largest, displacement_m=np.zeros((1 + (1 << 9), 11, 11, 11, 3)))


def test_a_file_round_trips_and_foreign_files_are_refused(tmp_path: Path) -> None:
    bent = replace(wavy(4, 0.0001), compliance_m_per_n=0.001, relax_s=0.2)
    bent.write(tmp_path / "a.npz")
    back = read_deformation(tmp_path / "a.npz")
    assert np.abs(back.displacement_m - bent.displacement_m).max() <= STEP_M / 2 + 1e-12
    assert (back.corner_m, back.spacing_m, back.rate_hz) == (bent.corner_m, bent.spacing_m, bent.rate_hz)
    assert (back.compliance_m_per_n, back.relax_s) == (0.001, 0.2)
    back.write(tmp_path / "b.npz")
    assert np.array_equal(read_deformation(tmp_path / "b.npz").displacement_m, back.displacement_m)
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "c.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(SourceError, match=r"c\.npz"):
        read_deformation(tmp_path / "c.npz")
    with np.load(tmp_path / "a.npz") as stored:
        arrays = dict(stored)
    steps = np.rint(-1.2 / STEP_M * controls_m(bent)[None] * [1, 0, 0]).astype(int)
    folds = (steps << 1) ^ (steps >> 15)
    for name, value, message in (
        ("displacement", arrays["displacement"].astype(np.int32), "bytes"),
        ("displacement", arrays["displacement"][:1], "bytes"),
        ("displacement", np.stack([folds, folds >> 8]).astype(np.uint8), "a fold"),
        ("spacing_m", np.array([0.01, np.nan, 0.01]), "spacing_m"),
        ("rate_hz", np.array([0.0]), "rate_hz"),
    ):
        np.savez(tmp_path / "d.npz", **(arrays | {name: value}))
        with pytest.raises(SourceError, match=message):
            read_deformation(tmp_path / "d.npz")
    np.savez(tmp_path / "d.npz", **{k: v for k, v in arrays.items() if k != "relax_s"})
    with pytest.raises(SourceError, match="relax_s"):
        read_deformation(tmp_path / "d.npz")


# -- tracks ------------------------------------------------------------------------------------------------


def test_tracks_animate_a_static_medium_and_follow_a_moving_one() -> None:
    bent, p = wavy(5), random_points(50)
    of_static = FieldSampler(medium(ball), deformation=bent)
    moving = FieldSampler(medium(ball, 5), deformation=replace(bent, rate_hz=50.0))
    for frame in range(5):
        expected_sampler = FieldSampler(
            medium(ball), deformation=replace(bent, displacement_m=bent.displacement_m[frame : frame + 1])
        )
        expected = expected_sampler.force_n(np.zeros(len(p)), p)
        assert np.array_equal(of_static.force_n(np.full(len(p), frame / 10), p), expected)
        assert np.array_equal(moving.force_n(np.full(len(p), frame / 50), p), expected)
    with pytest.raises(InvalidArgument, match="tracks of 5 frames; expected 1 or 3"):
        FieldSampler(medium(ball, 3), deformation=bent)
    with pytest.raises(InvalidArgument, match="tool or a proxy"):
        RenderSpec(deformation=bent, render="proxy")


def test_a_fit_finds_and_extrapolates_an_affine_motion() -> None:
    rest = random_points(600, 0.01)
    a = np.array([[0.95, -0.2, 0], [0.2, 0.95, 0], [0, 0, 1.05]])
    now = rest @ a.T + [0.001, 0, 0]
    reported: list[int] = []
    fit, rms = fitted(
        rest, [rest, now], Deformation.at_rest((-0.013,) * 3, (0.013,) * 3), 25.0, reported.append
    )
    assert reported == [1, 2] and rms < 2e-6 and not fit.displacement_m[0].any() and fit.rate_hz == 25.0
    p = random_points(200, 0.006, seed=9) @ a.T + [0.001, 0, 0]
    back = p + moved(fit, fit.displacement_m[1], p)
    assert np.abs(back - (p - [0.001, 0, 0]) @ np.linalg.inv(a).T).max() < 2e-5
    with pytest.raises(InvalidArgument, match="frame 1: found 599 vertices"):
        fitted(rest, [rest, now[1:]], Deformation.at_rest(*BOX), 25.0)
    with pytest.raises(InvalidArgument, match="fit that folds"):
        fitted(rest, [rest * [-1, 1, 1]], Deformation.at_rest(*BOX), 25.0)


# -- compliance --------------------------------------------------------------------------------------------


def soft(compliance: float, relax_s: float = 0.02, controls: int = 8) -> Deformation:
    return Deformation.at_rest(
        (-0.07,) * 3, (0.07,) * 3, controls, compliance_m_per_n=compliance, relax_s=relax_s
    )


@pytest.mark.parametrize("compliance", [0.0005, 0.002])
def test_a_compliant_wall_is_a_spring_in_series(compliance: float) -> None:
    depth, stiffness = 0.004, 300.0
    lattice = soft(compliance)
    bench = Bench(
        wall(stiffness), RenderSpec(damping_n_s_per_m=0.0, coupling_n_per_m=0.0), deformation=lattice
    )
    force = bench.settled(0.003, -0.011, -depth, 400)
    expected = stiffness * depth / (1 + stiffness * compliance)
    # the lattice also bends about the force, which adds a second-order term
    assert force[2] == pytest.approx(expected, rel=0.12) and np.abs(force[:2]).max() < 0.1 * force[2]
    assert force[2] < stiffness * depth
    yield_m = bench.memory.array(np.float64, bench.yields, lattice.displacement_m.size)
    assert 0 < np.abs(yield_m).max() <= soft(compliance).max_yield_m
    before = np.abs(yield_m).max()
    for _ in range(20):  # one time constant
        bench.tick(0.0, 0.0, 0.02)
    assert np.abs(yield_m).max() == pytest.approx(before * np.exp(-1), rel=1e-6)


def test_hard_pressing_never_folds_the_lattice() -> None:
    lattice = soft(0.5, 0.001)
    bench = Bench(wall(2000.0), RenderSpec(damping_n_s_per_m=0.0, coupling_n_per_m=0.0), deformation=lattice)
    rng = np.random.default_rng(2)
    for _ in range(300):
        bench.tick(*rng.uniform(-0.06, 0.06, 2), -0.05)
    yield_m = bench.memory.array(np.float64, bench.yields, lattice.displacement_m.size)
    assert np.abs(yield_m).max() == pytest.approx(lattice.max_yield_m)
    assert replace(
        lattice, displacement_m=yield_m.reshape(lattice.displacement_m.shape), compliance_m_per_n=0.0
    )


@pytest.mark.parametrize("stiffness", [200.0, 1000.0])
@pytest.mark.parametrize("relax_s", [0.005, 0.1])
def test_a_hand_on_a_compliant_wall_comes_to_rest(stiffness: float, relax_s: float) -> None:
    device = replace(OMNI, force_max_n=12.0)
    spec = RenderSpec(damping_n_s_per_m=2.0, coupling_n_per_m=0.0)
    bench = Bench(wall(stiffness, 10.0), spec, device, deformation=soft(0.001, relax_s))
    z, v, mass, push = 0.002, 0.0, 0.15, -0.8
    heights = []
    for _ in range(4000):
        force = bench.tick(0.001, 0.002, z)[2]
        v += (force + push - 1.0 * v) / mass * 1e-3
        z += v * 1e-3
        heights.append(z)
    tail = np.array(heights[-500:])
    assert np.ptp(tail) < 2e-6
    assert -tail[-1] > 0.8 / stiffness + 0.0005  # deeper than in a rigid wall


class Pressing(Simulated):
    """Moves into the ball along z and stays there."""

    def position_m(self) -> tuple[float, float, float]:
        return 0.0, 0.0, max(0.018 - 4e-5 * len(self.forces), 0.006)


def test_the_player_applies_a_deformation() -> None:
    lattices = (None, Deformation.at_rest(*BOX), Deformation.at_rest(*BOX, compliance_m_per_n=0.002))
    forces = []
    for lattice in lattices:
        spec = RenderSpec(render="field", damping_n_s_per_m=0.0, coupling_n_per_m=0.0, deformation=lattice)
        device = Pressing()
        run_offline(medium(ball), OMNI, lambda device=device: device, spec, seconds=0.5)
        forces.append(np.array(device.forces))
    assert forces[0].any() and np.array_equal(forces[0], forces[1])
    assert 0.3 * np.abs(forces[0]).max() < np.abs(forces[2][:499]).max() < 0.9 * np.abs(forces[0]).max()


# -- the command -------------------------------------------------------------------------------------------


def test_an_animated_model_bends_the_stream_of_a_pose(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = chain_rig(joints=10, triangles=1500, frames=20).save(tmp_path / "snake.glb", "glb")
    stream, tracks = tmp_path / "snake.touch", tmp_path / "snake.npz"
    options = ["--frames", "0:1", "--nw", "5", "--representation", "voxel"]
    assert _exit_code(["encode", str(model), str(stream), *options]) == 0
    capsys.readouterr()
    assert (
        _exit_code(["deform", str(stream), str(model), "-o", str(tracks), "--frames", "0:5", "--json"]) == 0
    )
    report = json.loads(capsys.readouterr().out)
    assert report["frames"] == 5 and report["control_points"] == [8, 8, 8] and report["min_determinant"] > 0
    bent = read_deformation(tracks)
    assert not bent.displacement_m[0].any() and bent.displacement_m[-1].any()
    with pipeline.open_file(stream) as opened:
        spacing_mm = 1e3 * float(np.mean(opened.grid.spacing_m))
    assert 0.02 * spacing_mm < report["rms_mm"] < 0.2 * spacing_mm, (
        "millimetres, as few controls cannot follow it all"
    )
    play = ["play", str(stream), "--offline", "--seconds", "0.1", "--deformation"]
    assert _exit_code([*play, str(tracks)]) == 0
    for arguments, message in (
        (["deform", str(stream), "-o", str(tracks)], "no model and no compliance"),
        (["deform", str(stream), str(model), "-o", str(tracks), "--frames", "30:31"], "--frames"),
        (["deform", str(stream), str(model), "-o", str(stream)], "snake.touch"),
        (["deform", str(stream), str(model), "-o", str(tracks.with_suffix(".npy"))], "DEFORMATION.npz"),
        ([*play, str(stream)], "snake.touch"),
    ):
        capsys.readouterr()
        assert _exit_code(arguments) != 0
        stderr = capsys.readouterr().err
        assert message in stderr and len(stderr.strip().splitlines()) == 1
    assert np.array_equal(read_deformation(tracks).displacement_m, bent.displacement_m), "it is as it was"


# -- a lattice whose axes differ
# ------------------------------------------------------------------------------------


def uneven(**more: float) -> Deformation:
    """2, 3 and 5 cells of three sides."""
    return Deformation(np.zeros((1, 5, 6, 8, 3)), (-0.013, -0.0165, -0.02), (0.013, 0.011, 0.008), **more)


def test_an_affine_map_is_exact_on_an_uneven_lattice() -> None:
    lattice = uneven()
    a, shift = (
        np.array([[0.1, -0.05, 0.02], [0.03, -0.08, 0.04], [-0.02, 0.06, 0.05]]),
        [0.001, -0.0005, 0.0008],
    )
    bent = replace(lattice, displacement_m=(controls_m(lattice) @ a.T + shift)[None])
    p = random_points(reach_m=1.0) * [0.0129, 0.0164, 0.0175]
    found = FieldSampler(medium(spring), deformation=bent).force_n(np.zeros(len(p)), p).astype(float)
    j = np.eye(3) + a
    expected = spring(p @ j.T + shift) @ j
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    assert moved(bent, bent.displacement_m[0], p) == pytest.approx(p @ a.T + shift, abs=1e-12)
    assert bent.min_determinant()[0] == pytest.approx(np.linalg.det(j))
    assert np.linalg.norm(j, 2) <= bent.max_stretch < 1.15 * np.linalg.norm(j, 2)


def test_a_lattice_at_rest_fills_its_box_along_each_axis() -> None:
    low, high = np.array([-0.01, 0.02, -0.05]), np.array([0.02, 0.03, 0.01])
    lattice = Deformation.at_rest(low, high, 6, compliance_m_per_n=0.003, relax_s=0.07)
    assert lattice.corner_m == pytest.approx(low) and lattice.spacing_m == pytest.approx((high - low) / 3)
    assert lattice.displacement_m.shape == (1, 6, 6, 6, 3) and not lattice.displacement_m.any()
    assert (lattice.compliance_m_per_n, lattice.relax_s) == (0.003, 0.07)
    assert Deformation.at_rest(low, high).displacement_m.shape[1:4] == (8, 8, 8)
    two = replace(uneven(), displacement_m=np.zeros((2, 5, 6, 8, 3)))
    assert repr(two) == "<Deformation: 2 frames of 5 x 6 x 8 control points>"


@pytest.mark.parametrize("axis", range(3))
def test_max_yield_is_reduced_by_the_slope_of_the_tracks(axis: int) -> None:
    lattice = uneven()
    max_slope = np.sqrt(sum(3 * (2 / h) ** 2 for h in lattice.spacing_m))  # of the slope, for a metre
    assert lattice.max_yield_m == pytest.approx(0.95 / max_slope)
    tracks = np.zeros((2, 5, 6, 8, 3))
    tracks[1] = 0.3 * np.roll(controls_m(lattice), 1, axis=-1) * np.roll(np.eye(3)[axis], 1)
    assert replace(lattice, displacement_m=tracks).max_yield_m == pytest.approx((0.95 - 0.3) / max_slope)


def test_a_fit_on_an_uneven_lattice_finds_an_affine_motion() -> None:
    rest = random_points(600, 1.0) * [0.009, 0.012, 0.015]
    a = np.array([[0.95, -0.1, 0], [0.1, 1.02, 0.05], [0, 0.03, 1.05]])
    now = rest @ a.T + [0.001, 0, -0.0005]
    fit, rms = fitted(rest, [rest, now], uneven(), 25.0)
    residual_m = now + moved(fit, fit.displacement_m[1], now) - rest
    of_both = np.sqrt((residual_m**2).sum(axis=1).mean() / 2)
    assert rms == pytest.approx(of_both) and rms < 2e-6
    assert (fit.corner_m, fit.spacing_m) == (uneven().corner_m, uneven().spacing_m)


def test_a_wall_yields_alike_on_an_uneven_lattice() -> None:
    spec = RenderSpec(damping_n_s_per_m=0.0, coupling_n_per_m=0.0)
    spacing = (0.07, 0.14 / 3, 0.028)
    lattice = Deformation(np.zeros((1, 5, 6, 8, 3)), (-0.07,) * 3, spacing, 1.0, 0.0005, 0.02)
    force = Bench(wall(300.0), spec, deformation=lattice).settled(0.003, -0.011, -0.004, 400)
    assert (
        force[2] == pytest.approx(300 * 0.004 / 1.15, rel=0.12) and np.abs(force[:2]).max() < 0.1 * force[2]
    )
