"""M(W) for devices: cropping, clipping, resampling and pooling, in bits (paper eq. 1 to 3)."""

from __future__ import annotations

import numpy as np
import pytest

from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.devices import device
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.partition import map_to_device
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.measure import MeasureSpec, measure_medium

QUANTISER = FieldQuantiserSpec.parse("weber:0.1")


def medium(shape: tuple[int, int, int], box_m: tuple[float, float, float], seed: int = 0) -> HapticMedium:
    """Random forces of 0 to 8 N in the inner half of a box."""
    rng = np.random.default_rng(seed)
    grid = Grid.over_box([-b / 2 for b in box_m], [b / 2 for b in box_m], shape)
    forces = rng.normal(size=(*shape, 3)) * 2.5
    outer = np.ones(shape, bool)
    outer[tuple(slice(n // 4, -(n // 4)) for n in shape)] = False
    forces[outer] = 0
    return HapticMedium.from_frames([ForceField.from_dense(grid, forces)], 30.0)


def test_a_finer_device_gets_the_samples_of_the_medium() -> None:
    w = medium((24, 18, 16), (0.16, 0.12, 0.07))
    mapped = map_to_device(w, "phantom-omni", QUANTISER)
    assert mapped.medium.grid.shape == w.grid.shape and any("finer" in note for note in mapped.notes)
    x, y = w[0].to_dense(), mapped.medium[0].to_dense()
    size = np.linalg.norm(x, axis=-1, keepdims=True)
    clipped = x * np.minimum(1, device("phantom-omni").force_max_n / np.maximum(size, 1e-9))
    np.testing.assert_allclose(y, clipped, atol=1e-5)
    assert np.linalg.norm(y, axis=-1).max() <= 3.3 + 1e-6 < size.max()


def test_a_small_workspace_crops_unreachable_samples() -> None:
    w = medium((50, 50, 50), (1.0, 1.0, 1.0))
    mapped = map_to_device(w, "phantom-omni", QUANTISER, EncodeSpec(mapping="crop"))
    grid = mapped.medium.grid
    low, high = grid.box_m
    workspace = np.array(device("phantom-omni").workspace_m)
    # all samples within the workspace and no others
    assert (high - low < workspace + 0.02 + 1e-9).all() and (high - low > workspace - 0.02 - 1e-9).all()
    corner = np.round(w.grid.to_index(grid.origin_m)).astype(int)
    part = w[0].to_dense()[tuple(slice(c, c + n) for c, n in zip(corner, grid.shape))]
    part *= np.minimum(1, 3.3 / np.maximum(np.linalg.norm(part, axis=-1, keepdims=True), 1e-9))
    np.testing.assert_allclose(mapped.medium[0].to_dense(), part, atol=1e-5)
    found = measure_medium(
        w, MeasureSpec(devices=("phantom-omni",), limits=False, encode=EncodeSpec(mapping="crop"))
    )
    assert found.capacities["phantom-omni"].wmr.value < 0.1, "most of the scene is out of reach"


def test_a_coarser_device_gets_its_lattice() -> None:
    w = medium((40, 40, 40), (0.0042, 0.0042, 0.0042))  # in hand metres, finer than an Omni's 55 micrometres
    mapped = map_to_device(w, "phantom-omni", QUANTISER, EncodeSpec(mapping="0.25"))
    assert mapped.medium.grid.shape == (19, 19, 19)
    low, high = mapped.medium.grid.box_m
    np.testing.assert_allclose(high - low, 0.25 * 0.0042, rtol=1e-6)


def test_an_array_has_its_actuators_and_its_levels() -> None:
    w = medium((24, 18, 16), (0.16, 0.12, 0.07))
    mapped = map_to_device(w, "dotpad", QUANTISER)
    profile = device("dotpad")
    assert mapped.medium.grid.shape == (*profile.lattice[:2], 1)
    assert profile.levels is not None
    assert mapped.quantiser.text == f"uniform:{profile.force_max_n / (profile.levels - 1)!r}/none"
    forces = mapped.medium[0].to_dense()
    assert not forces[..., :2].any() and forces[..., 2].max() <= profile.force_max_n + 1e-6


@pytest.mark.parametrize("name", ["phantom-omni", "novint-falcon", "delta.3"])
def test_a_clip_alone_never_adds_information(name: str) -> None:
    w = medium((24, 18, 16), (0.16, 0.12, 0.07), seed=3)
    found = measure_medium(w, MeasureSpec(devices=(name,), limits=False, quantiser="weber:0.1"))
    c = found.capacities[name]
    assert c.rendered.value <= c.reference.value + 1e-6
    assert c.wmr.value + c.hil.value == pytest.approx(1, abs=1e-12)


def bands(shape: tuple[int, int, int], top_n: float) -> HapticMedium:
    """Waves of 0 to `top_n` newtons that fill the lattice along z."""
    grid = Grid.over_box([-0.05, -0.04, -0.03], [0.05, 0.04, 0.03], shape)
    x, y, z = np.indices(shape) * np.pi / 7
    forces = np.zeros((*shape, 3))
    forces[..., 2] = top_n * np.sin(x) ** 2 * np.cos(y + np.cos(z)) ** 2
    return HapticMedium.from_frames([ForceField.from_dense(grid, f * forces) for f in (1.0, 0.9)], 30.0)


@pytest.mark.parametrize("name", ["phantom-omni", "tshirt-32x32"])
def test_w_and_its_rendering_are_measured_jointly(name: str) -> None:
    """With a clip, and an array that pools the depth: the ratio has a narrower interval than the
    two values, if they have any.
    """
    found = measure_medium(bands((48, 40, 24), 6.0), MeasureSpec(devices=(name,), limits=False)).capacities[
        name
    ]
    i, h, c = found.wmr.interval, found.reference.interval, found.rendered.interval
    assert i is not None and found.hil.interval is not None and found.wmr.dependence is not None
    assert i.method.startswith("paired, spectrum of") and i.level == 0.95
    assert i.low <= found.wmr.value <= i.high <= 1
    assert (found.hil.interval.low, found.hil.interval.high) == pytest.approx(
        (1 - i.high, 1 - i.low), abs=1e-12
    )
    if h is not None and c is not None:
        assert i.high - i.low < min(1.0, c.high / h.low) - c.low / h.high


def test_a_window_with_little_overlap_has_the_interval_of_the_corners() -> None:
    w = medium((50, 50, 50), (1.0, 1.0, 1.0))
    spec = MeasureSpec(devices=("phantom-omni",), limits=False, encode=EncodeSpec(mapping="crop"))
    i = measure_medium(w, spec).capacities["phantom-omni"].wmr.interval
    assert i is None or i.method.startswith("interval arithmetic")


def test_the_source_lattice_is_aligned_with_the_device() -> None:
    w = medium((24, 18, 16), (0.16, 0.12, 0.07))
    mapped = map_to_device(w, "phantom-omni", QUANTISER)
    source_grid, finer = mapped.source_grid, mapped.medium.grid
    assert source_grid.shape == w.grid.shape == finer.shape
    np.testing.assert_allclose(np.stack(source_grid.box_m), np.stack(finer.box_m), atol=1e-12)
