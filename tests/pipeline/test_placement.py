"""The position of a scene in the workspace of a device, and its lattice."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from random_fields import OMNI
from touchfield.container.records import Head, rows_of
from touchfield.devices import device
from touchfield.errors import InvalidArgument, SourceError
from touchfield.filters import (
    Placement,
    device_grid,
)
from touchfield.pipeline import encode
from touchfield.pipeline.placement import MAX_OFFSET_M, MIN_SCALE
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.terrain.height_scene import HeightScene

boxes = st.tuples(*[st.floats(-50, 50)] * 3, *[st.floats(0, 30) | st.just(0.0)] * 3).filter(
    lambda b: max(b[3:]) > 1e-3
)


@given(boxes, st.tuples(*[st.floats(0.05, 2)] * 3), st.floats(0, 0.02))
def test_fit_fills_the_workspace_and_no_more(
    box: tuple[float, ...], workspace: tuple[float, float, float], margin: float
) -> None:
    low, extent = np.array(box[:3]), np.array(box[3:])
    placement = Placement.fit([low, low + extent], workspace, margin)
    corners = placement.scale * (np.array([low, low + extent]) - placement.offset_m)
    half_size_m = np.array(workspace) / 2 - margin
    assert (np.abs(corners) <= half_size_m * (1 + 1e-6) + 1e-9).all()
    assert np.isclose(np.abs(corners), half_size_m, rtol=1e-5).any()


def test_crop_and_scale_keep_the_centre_of_the_box() -> None:
    box = [[1.0, 2.0, 3.0], [2.0, 6.0, 3.0]]
    assert Placement.scaled(box, 1.0) == Placement(1.0, (1.5, 4.0, 3.0))
    assert Placement.scaled(box, 0.05) == Placement(0.05, (1.5, 4.0, 3.0))
    assert Placement.fit(box, (0.1, 0.1, math.inf)) == Placement(0.1 / 4, (1.5, 4.0, 3.0))
    grid = device_grid(OMNI, 5)
    placement = Placement.scaled(box, 0.05)
    scene_grid = placement.to_scene(grid)
    assert scene_grid.spacing_m == pytest.approx(np.array(grid.spacing_m) * 20)
    assert np.mean(scene_grid.box_m, axis=0) == pytest.approx((1.5, 4.0, 3.0))
    assert np.allclose(placement.to_hand(scene_grid).box_m, grid.box_m, atol=1e-15)


@pytest.mark.parametrize(
    "box",
    [
        [[0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [1, -1, 1]],
        [[0, 0, 0], [1, math.nan, 1]],
        [[0, 0, 0], [1, math.inf, 1]],
        [0, 1],
        [[-1e308] * 3, [1e308] * 3],
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_an_invalid_box_is_refused(box: list[list[float]]) -> None:
    with pytest.raises(InvalidArgument, match="scene_box_m"):
        Placement.fit(box, (1, 1, 1))


def test_invalid_placements_are_refused() -> None:
    box = [[0, 0, 0], [1, 1, 1]]
    for margin in (0.5, -0.1, math.nan):
        with pytest.raises(InvalidArgument, match="margin_m"):
            Placement.fit(box, (1, 1, 1), margin)
    for workspace in ((1, 1), (1, 0, 1), (1, math.nan, 1), (math.inf,) * 3):
        with pytest.raises(InvalidArgument, match="workspace_m"):
            Placement.fit(box, workspace)
    for scale in (0.0, -1.0, math.inf, math.nan, 1e-320):
        with pytest.raises(InvalidArgument, match="scale"):
            Placement.scaled(box, scale)
    with pytest.raises(InvalidArgument, match="offset_m"):
        Placement(1.0, (0.0, math.nan, 0.0))


def test_the_lattice_fills_the_workspace() -> None:
    grid = device_grid(OMNI, 5)
    assert grid.shape == (32, 32, 32)
    assert np.allclose(grid.box_m, [(-0.08, -0.06, -0.035), (0.08, 0.06, 0.035)])
    nominal = device_grid(OMNI)
    assert nominal.shape == (2909, 2182, 1273)
    assert np.allclose(nominal.spacing_m, 55e-6, rtol=1e-3)
    for nw in (2, 11, -1, 5.5):
        with pytest.raises(InvalidArgument, match="nw"):
            device_grid(OMNI, nw)  # type: ignore[arg-type]


def test_note_states_the_true_heights_of_a_map() -> None:
    heights = np.add.outer(np.linspace(0, 40, 30), np.linspace(260, 300, 50))
    for device_name, message in (
        ("graphiti", "down at z = 260 m of the scene and up at 340 m"),
        ("phantom-omni", "fits"),
    ):
        for factor in (1.0, 5.0):
            scene = HeightScene(heights, (10.0, 10.0), exaggeration=factor)
            length, *_ = prepare(scene, EncodeSpec(device=device_name, nw=5)).notes
            assert message in length and ("heights 5 times what they are" in length) == (factor == 5.0)


def test_options_of_another_kind_of_device_are_noted() -> None:
    scene = HeightScene(np.zeros((5, 5)), (10.0, 10.0))
    spec = EncodeSpec(nw=4, pool="mean")
    for name, idle in (("graphiti", "--nw"), ("phantom-omni", "--pool")):
        notes = prepare(scene, replace(spec, device=name)).notes
        assert f"Options that do nothing for {name}: {idle}." in notes


def test_a_wall_thinner_than_the_spacing_is_noted() -> None:
    scene = HeightScene(np.zeros((5, 5)), (10.0, 10.0))
    for thickness_m, nw, is_noted in ((0.002, 5, True), (0.002, 7, False), (None, 5, False)):
        notes = prepare(scene, EncodeSpec(nw=nw, thickness_m=thickness_m)).notes
        assert any("2 mm is thinner than the 5 mm" in note for note in notes) == is_noted
    for thickness_m, is_noted in ((3.0, True), (0.1, False)):
        notes = prepare(scene, EncodeSpec(nw=5, thickness_m=thickness_m)).notes
        assert any("3 mm are --thickness-m 0.003" in note for note in notes) == is_noted
    with pytest.raises(InvalidArgument, match=r"band_m: found 3; expected metres, less than half"):
        prepare(scene, EncodeSpec(nw=5, law="proximity", band_m=3.0))
    pins = prepare(scene, EncodeSpec(device="graphiti", thickness_m=0.002)).notes
    assert not any("is thinner than" in note for note in pins), "an array pools what lies between"


def test_an_array_has_the_lattice_of_its_actuators() -> None:
    pad = device("dotpad")
    grid = device_grid(pad, 7)
    assert grid.shape == (60, 40, 1)
    assert grid.spacing_m == pytest.approx((0.0025, 0.0025, 0.15))
    assert device_grid(pad, depth_m=0.5).spacing_m[2] == 0.5


@pytest.mark.parametrize(
    ("unit_m", "offset", "message"),
    [
        (1e-34, 0.0, r"a scene of .* m; .*Check --unit-m"),
        (1.0, 1e10, r"a scene 1e\+10 m from its origin; expected at most 1e\+09 m.*--unit-m"),
    ],
)
def test_a_size_that_no_file_can_state_is_refused_in_words(
    tmp_path: Path, unit_m: float, offset: float, message: str
) -> None:
    """The limits are those of the format, whose field names do not appear."""
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    lines = [f"v {' '.join(repr(float(unit_m * c + offset)) for c in corner)}" for corner in corners]
    mesh = tmp_path / "mesh.obj"
    mesh.write_text("\n".join([*lines, "f 1 3 2", "f 1 2 4", "f 2 3 4", "f 1 4 3"]))
    with pytest.raises(SourceError, match=message) as caught:
        encode(mesh, tmp_path / "out.touch", EncodeSpec(nw=3))
    assert "HEAD" not in str(caught.value)
    scale, offsets = (row.kind for row in rows_of(Head) if row.name in ("mapping_scale", "mapping_offset_m"))
    assert f"{MIN_SCALE:g}" in scale.bounds and f"{int(MAX_OFFSET_M)}" in offsets.bounds.replace(",", "")
