"""Fitting into the workspace: the requested frames, with a margin and a note."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from touchfield.cli.main import load_commands
from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.medium import Grid, PoseTrack
from touchfield.medium.grid import Placement
from touchfield.pipeline import encode, prepare
from touchfield.pipeline.decoding import open_file, write_field
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import CAMERA_AXES, UP_Z_AXES, Body, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Sphere
from touchfield.sources.terrain.height_scene import HeightScene
from touchfield.tasks.view import draw_preview

GRID = Grid((4, 5, 6), (0.01, 0.02, 0.03), (-0.1, 0.0, 0.1))


class Receding(DepthSequence):
    """A slanted wall, at 1 m in frame 0 and 1 m farther in each later frame."""

    name, frame_count, width, height, rate_hz = "receding", 4, 32, 24, 30.0
    intrinsics = Intrinsics(30.0, 30.0, 15.5, 11.5)

    def depth_m(self, frame: int) -> np.ndarray:
        return (1 + frame + np.tile(np.linspace(0, 0.5, 32), (24, 1))).astype(np.float32)


def bodies() -> Scene:
    track = PoseTrack(np.tile([1.0, 0, 0, 0], (4, 1)), np.linspace([0, 0, 0], [0.9, 0, 0], 4))
    return BodyScene([Body("ball", AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.05),)), track)], 30.0)


MOVING = {
    "depth": lambda: DepthScene(Receding()),
    "heights": lambda: HeightScene.from_depth_sequence(Receding()),
    "bodies": bodies,
}


@pytest.mark.parametrize("make", MOVING.values(), ids=MOVING)
def test_the_selected_frames_are_fitted(make) -> None:
    complete = prepare(make(), EncodeSpec(nw=4))
    part = prepare(make(), EncodeSpec(nw=4, frames=(0, 1)))
    part_as_complete = prepare(make(), EncodeSpec(nw=4, frames=(0, 1), fit_frames=(0, None)))
    other = prepare(make(), EncodeSpec(nw=4, fit_frames=(0, 1)))
    assert part.placement.scale > 1.2 * complete.placement.scale
    assert part_as_complete.placement == complete.placement and len(part_as_complete.medium) == 1
    assert other.placement == part.placement and len(other.medium) == 4
    assert any("in frames 0 to 3 fits" in note for note in complete.notes)
    assert any(
        "in frames 0 to 0 fits" in note and "3.5 mm of it left on every side" in note for note in part.notes
    )


def test_a_scan_that_fills_the_depth_has_its_face_inside_the_workspace() -> None:
    box = AnalyticScene((Box((0.0, 0.0, 0.0), (0.02, 0.02, 0.05)),))
    prepared = prepare(box, EncodeSpec(nw=6))
    face_mm = 1e3 * prepared.placement.scale * 0.05
    assert face_mm == pytest.approx(35 - 3.5)  # of the Omni's 70 mm
    forces_n = prepared.medium[0].sample_n([[0, 0, 0.0345], [0, 0, 0.030]])
    assert (
        not forces_n[0].any() and forces_n[1, 2] > 0
    )  # there is space before the face, and a pushing force behind it
    filled = prepare(box, EncodeSpec(nw=6, mapping="fill"))
    assert 2 * filled.placement.scale * 0.05 == pytest.approx(device("phantom-omni").workspace_m[2])


@pytest.mark.parametrize(
    ("spec", "option"), [({"frames": (2, 9)}, "2:9"), ({"fit_frames": (4, None)}, "4:4")]
)
def test_missing_frames_are_refused(spec: dict, option: str) -> None:
    with pytest.raises(InvalidArgument, match=rf"{option}.*within 0:4"):
        prepare(DepthScene(Receding()), EncodeSpec(nw=4, **spec))
    assert EncodeSpec.from_json(EncodeSpec(fit_frames=(1, None)).to_json()).fit_frames == (1, None)


# -- scene to hand and back --------------------------------------------------------------------------------


def test_points_round_trip_between_scene_and_hand() -> None:
    placement = Placement(0.05, (1.0, -2.0, 3.0))
    points = np.random.default_rng(0).normal(size=(7, 3))
    assert np.allclose(placement.to_hand([[1.0, -2.0, 3.0], [2.0, -2.0, 3.0]]), [[0, 0, 0], [0.05, 0, 0]])
    assert np.allclose(placement.to_scene(placement.to_hand(points)), points)
    assert np.allclose(placement.to_scene(GRID).to_m([1, 2, 3]), placement.to_scene(GRID.to_m([1, 2, 3])))


@pytest.mark.parametrize(
    ("scale", "ratio"), [(1e-3, "1 m of"), (0.05, "20 mm of"), (4.0, "250 um of"), (1e-7, "10 km of")]
)
def test_wording_of_the_scale(scale: float, ratio: str) -> None:
    assert Placement(scale).wording == f"1 mm of the hand is {ratio} the scene"


def test_every_output_states_the_mapping(tmp_path: Path) -> None:
    """Summaries, info, npz and vti state the mapping; a corner of the scene has its force there."""
    box = AnalyticScene((Box((0.4, 0.0, 0.0), (0.02, 0.02, 0.05)),))
    done = encode(box, tmp_path / "a.touch", EncodeSpec(nw=4))
    placement = done.prepared.placement
    write_field(tmp_path / "a.npz", done.prepared.medium, placement=placement)
    write_field(tmp_path / "a.vti", done.prepared.medium, placement=placement)
    with open_file(tmp_path / "a.touch") as stream:
        assert stream.placement == placement
        of_stream = stream.summary()
        inside = stream.medium[0].sample_n(placement.to_hand([0.4, 0.0, 0.047]))
    assert inside[2] > 0
    for summary in (of_stream, done.summary()):
        assert summary["mapping_scale"] == placement.scale
        assert summary["mapping_offset_m"] == [0.4, 0.0, 0.0]
        assert summary["axes"] == box.axes
    with np.load(tmp_path / "a.npz") as stored:
        assert stored["mapping_scale"].tolist() == [placement.scale]
        assert stored["mapping_offset_m"].tolist() == [0.4, 0.0, 0.0]
    text = (tmp_path / "a.vti").read_bytes().decode("latin-1")
    assert (
        f'Name="mapping_scale">{placement.scale!r}<' in text
        and 'Name="mapping_offset_m">0.4 0.0 0.0<' in text
    )
    assert prepare(tmp_path / "a.npz", EncodeSpec(nw=4)).medium[0] == done.prepared.medium[0]


@pytest.mark.parametrize("axes", [CAMERA_AXES, UP_Z_AXES])
def test_a_preview_shows_the_position_of_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, axes: str
) -> None:
    pytest.importorskip("matplotlib")
    box = AnalyticScene((Box((0.4, 0.0, 0.0), (0.04, 0.02, 0.05)),))
    box.axes = axes
    drawn: list = []
    monkeypatch.setattr("touchfield.tasks.view.write_png", lambda figure, path: drawn.append(figure))
    prepared = prepare(box, EncodeSpec(nw=5))
    draw_preview(prepared, tmp_path / "a.png")
    (figure,) = drawn
    assert "frame 1 of 1" in figure.get_suptitle()
    front, side, above = figure.axes[:3]
    half_mm = 1e3 * prepared.placement.scale * np.array([0.04, 0.02, 0.05])
    panel_axes = ((0, 2), (1, 2), (0, 1)) if axes == UP_Z_AXES else ((0, 1), (2, 1), (0, 2))
    for panel, (across, up) in zip((front, side, above), panel_axes, strict=True):
        shadow = panel.images[0].get_array().filled(0) > 0.1
        low_x, high_x, low_y, high_y = panel.images[0].get_extent()
        ys, xs = np.nonzero(shadow)
        for indices, low, high, count, half in (
            (xs, low_x, high_x, shadow.shape[1], half_mm[across]),
            (ys, low_y, high_y, shadow.shape[0], half_mm[up]),
        ):  # fmt: skip
            step = (high - low) / count
            assert abs(low + step * indices.min() + half) < 1.6 * step
            assert abs(low + step * (indices.max() + 1) - half) < 1.6 * step
    # the viewer sits at the left of the side panel, and below the other: z points away, or y does
    assert not side.xaxis_inverted() and not above.yaxis_inverted()
    assert front.yaxis_inverted() == side.yaxis_inverted() == (axes == CAMERA_AXES)
    draw_preview(replace(prepared, device=device("tshirt-32x32")), tmp_path / "a.png")
    assert "up for the hand" not in str(drawn[1]._suptitle), "an array lies as it was laid"
    assert ("z up for the hand" in figure.texts[0].get_text() + str(figure._suptitle)) == (axes == UP_Z_AXES)


def test_field_draws_a_preview_without_writing_a_field(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    source = tmp_path / "ball.toml"
    source.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0, 0, 0]\nradius_m = 0.02\n')
    result = CliRunner().invoke(
        load_commands(), ["field", str(source), "--nw", "4", "--preview", str(tmp_path / "a.png"), "--json"]
    )
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["preview"] == str(tmp_path / "a.png") and "file" not in summary
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG") and not list(tmp_path.glob("*.npz"))
    assert CliRunner().invoke(load_commands(), ["field", str(source)]).exit_code != 0
