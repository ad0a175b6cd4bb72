"""A stored field without loss keeps its samples bit for bit; the summary states the reference of
the bound.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.medium import Grid
from touchfield.medium.stores.npz import read_npz
from touchfield.pipeline import compare, encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import SOURCE_FORCES, EncodeSpec
from touchfield.pipeline.stream import FILTERED

SPEC = EncodeSpec(nw=4, touch=TouchSpec(mode="lossless"))
SMALL = ((11, 9, 10), 0.002)


def stored(
    path: Path, frames: np.ndarray, spacing_m: float, origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Path:
    """Frames [n, nx, ny, nz, 3] as an archive."""
    np.savez(path, forces_n=frames, origin_m=origin_m, spacing_m=[spacing_m] * 3, rate_hz=30.0)
    return path


def quantised(shape: tuple[int, ...], frames: int = 2) -> np.ndarray:
    """Scattered quarters of a newton, with zeros of both signs between them."""
    rng = np.random.default_rng(3)
    forces = rng.integers(-3, 4, (frames, *shape, 3)) / np.float32(4)
    forces[rng.random((frames, *shape)) < 0.7] = 0
    return np.where(rng.random(forces.shape) < 0.1, -forces, forces).astype(np.float32)


def decoded(path: Path) -> tuple[Grid, np.ndarray]:
    with open_file(path) as opened:
        return opened.grid, np.stack([frame.to_dense() for frame in opened.medium])


@pytest.mark.parametrize("origin_m", [(0.0, 0.0, 0.0), (-0.01, 0.013, -0.02)])
def test_a_stored_field_keeps_its_lattice_and_every_bit(
    tmp_path: Path, origin_m: tuple[float, float, float]
) -> None:
    shape, spacing_m = SMALL
    forces = quantised(shape)
    source = stored(tmp_path / "a.npz", forces, spacing_m, origin_m)
    done = encode(source, tmp_path / "a.touch", SPEC)
    grid, found = decoded(tmp_path / "a.touch")
    assert grid == Grid(shape, (spacing_m,) * 3, origin_m) == read_npz(source).grid
    assert np.array_equal(found.view(np.uint32), forces.view(np.uint32))
    assert done.summary()["promise_against"] == SOURCE_FORCES
    assert any("on its own lattice" in note for note in done.notes)
    with open_file(tmp_path / "a.touch") as opened:
        assert opened.summary()["promise_against"] == SOURCE_FORCES and opened.summary()["promise_kept"]
    assert compare(source, tmp_path / "a.touch").summary()["mask_violations"] == 0


def test_bricks_of_negative_zeros_are_preserved(tmp_path: Path) -> None:
    forces = np.zeros((1, 16, 8, 9, 3), np.float32)
    forces[0, 1, 1, 1] = forces[0, 9, 2, 8, 1] = -0.0
    encode(stored(tmp_path / "a.npz", forces, 0.001), tmp_path / "a.touch", replace(SPEC, allow_empty=True))
    _, found = decoded(tmp_path / "a.touch")
    assert np.array_equal(np.signbit(found), np.signbit(forces)) and not found.any()


def test_an_offset_field_is_moved_and_a_scaled_one_keeps_its_forces(tmp_path: Path) -> None:
    shape, spacing_m = SMALL
    forces = quantised(shape)
    source = stored(tmp_path / "a.npz", forces, spacing_m, (5.0, 0.0, 0.0))
    for mapping, factor in (("fit", 1.0), ("crop", 1.0), ("2", 2.0)):
        spec = EncodeSpec(nw=4, mapping=mapping, touch=TouchSpec(mode="lossless"))
        done = encode(source, tmp_path / "a.touch", spec)
        grid, found = decoded(tmp_path / "a.touch")
        np.testing.assert_allclose(grid.spacing_m, factor * spacing_m)
        np.testing.assert_allclose(np.sum(grid.box_m, axis=0), 0, atol=1e-12)
        assert np.array_equal(found.view(np.uint32), forces.view(np.uint32))
        assert done.prepared.placement.scale == factor


def test_a_field_larger_than_the_workspace_is_refused(tmp_path: Path) -> None:
    shape, spacing_m = SMALL
    source = stored(tmp_path / "a.npz", quantised(shape), 10 * spacing_m)
    for mapping in ("fit", "1"):
        spec = EncodeSpec(nw=4, mapping=mapping, touch=TouchSpec(mode="lossless"))
        with pytest.raises(
            InvalidArgument, match=r"220 x 180 x 200 mm in a workspace of 160 x 120 x 70.*--device"
        ):
            encode(source, tmp_path / "a.touch", spec)
    with pytest.raises(InvalidArgument, match="mapping: found 'large'"):
        encode(source, tmp_path / "a.touch", EncodeSpec(mapping="large", touch=TouchSpec(mode="lossless")))
    encode(source, tmp_path / "a.touch", EncodeSpec(nw=4, mapping="0.25", touch=TouchSpec(mode="lossless")))
    assert decoded(tmp_path / "a.touch")[0].shape == shape


def test_the_reference_of_the_error_bound_is_stated(tmp_path: Path) -> None:
    shape, spacing_m = SMALL
    source = stored(tmp_path / "a.npz", quantised(shape), spacing_m)
    ball = tmp_path / "ball.toml"
    ball.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0, 0, 0]\nradius_m = 0.02\n')
    filtered = EncodeSpec(nw=4, touch=TouchSpec(mode="lossless"), filters=(("gaussian", "2mm"),))
    for scene, spec in ((ball, SPEC), (source, EncodeSpec(nw=4)), (source, filtered)):
        done = encode(scene, tmp_path / "a.touch", spec)
        assert done.summary()["promise_against"] == FILTERED
        with open_file(tmp_path / "a.touch") as opened:
            assert opened.summary()["promise_against"] == FILTERED
    encode(tmp_path / "a.touch", tmp_path / "b.touch", SPEC)
    with open_file(tmp_path / "b.touch") as opened:
        assert opened.summary()["promise_against"] == SOURCE_FORCES
