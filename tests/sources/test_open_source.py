"""The kind of a path: ``--as``, nested folders, names in errors, and implausible units."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import depth_makers as make
from touchfield.errors import InvalidArgument, SourceError
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions, WatchedOptions
from touchfield.sources.registry import open_source

MM = SourceOptions(depth_scale=1000)


def test_a_kind_can_be_requested_by_name(tmp_path: Path) -> None:
    folder = make.write_redwood(tmp_path / "s")
    assert open_source(folder, SourceOptions(kind="redwood")).frame_count == make.FRAMES
    with pytest.raises(InvalidArgument, match=r"--as.*'TUM'.*one of .*tum, redwood"):
        open_source(folder, SourceOptions(kind="TUM"))


def test_a_folder_of_a_folder_is_named_and_not_opened(tmp_path: Path) -> None:
    make.write_tum(tmp_path / "download_fr9")
    with pytest.raises(SourceError, match=r"no kind of source that is known, but the folders download_fr9/"):
        open_source(tmp_path)


def test_an_error_lists_the_contents_of_the_folder(tmp_path: Path) -> None:
    for i in range(3):
        make.write_png(tmp_path / f"{i}.png", np.zeros((4, 6, 3), np.uint8))
    (tmp_path / "colour").mkdir()
    with pytest.raises(
        SourceError, match=r"3 \.png \(a RGB picture of uint8 samples, 6 x 4\), the folders colour/"
    ):
        open_source(tmp_path)
    for kind in ("tum", "redwood", "sun3d", "3dmatch", "depth-folder"):
        with pytest.raises(SourceError, match=r"but 3 \.png|RGB"):
            open_source(tmp_path, SourceOptions(kind=kind, depth_scale=1000))


@pytest.mark.parametrize(
    ("scale", "message"), [(1, "m across (--depth-scale)."), (1000, None), (1e6, "m across (--depth-scale).")]
)
@pytest.mark.parametrize("reading", ["camera", "height"])
def test_depth_in_an_implausible_unit_is_noted(
    tmp_path: Path, scale: float, message: str | None, reading: str
) -> None:
    values = np.kron(make.depths_mm()[0], np.ones((8, 8), np.uint16))
    make.write_png(tmp_path / "depth" / "0.png", values)
    options = SourceOptions(depth_scale=scale, reading=reading, intrinsics="160,168,47.5,35.5")
    notes = prepare(tmp_path, EncodeSpec(nw=4, source=options)).notes
    assert ("Is the unit right?" in " ".join(notes)) == (message is not None)
    assert message is None or any(message in note for note in notes)


@pytest.mark.parametrize(
    ("unit_m", "message"),
    [(1.0, None), (1e-3, "6e-05 m across (--unit-m)."), (1e5, "6e+03 m across (--unit-m).")],
)
def test_a_mesh_in_an_implausible_unit_is_noted(tmp_path: Path, unit_m: float, message: str | None) -> None:
    corners = "v 0 0 0\nv 0.06 0 0\nv 0 0.06 0\nv 0 0 0.06\n"
    (tmp_path / "a.obj").write_text(corners + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    notes = prepare(tmp_path / "a.obj", EncodeSpec(nw=4, source=SourceOptions(unit_m=unit_m))).notes
    assert ("Is the unit right?" in " ".join(notes)) == (message is not None)
    assert message is None or any(message in note for note in notes)


def test_idle_options_are_noted(tmp_path: Path) -> None:
    values = np.kron(make.depths_mm()[0], np.ones((8, 8), np.uint16))
    make.write_png(tmp_path / "shot.png", values)  # its name does not suggest depth: a height map
    options = SourceOptions(
        depth_scale=1000, intrinsics="160,168,47.5,35.5", exaggeration=2.0, allow_outside=True
    )
    notes = prepare(tmp_path / "shot.png", EncodeSpec(nw=3, source=options)).notes
    assert "Options that do nothing for this source: --depth-scale, --intrinsics." in notes
    (tmp_path / "depth").mkdir()
    (tmp_path / "shot.png").rename(tmp_path / "depth" / "0.png")
    options = SourceOptions(
        depth_scale=1000, intrinsics="160,168,47.5,35.5", kind="depth-folder", rate_hz=10.0
    )
    assert "do nothing" not in " ".join(prepare(tmp_path, EncodeSpec(nw=3, source=options)).notes)
    assert "--seconds." in " ".join(
        prepare("sample:shapes", EncodeSpec(nw=3, source=SourceOptions(seconds=1))).notes
    )


# -- options
# --------------------------------------------------------------------------------------------------------

NUMBERS = [
    "depth_scale",
    "cell_size_m",
    "height_scale",
    "exaggeration",
    "unit_m",
    "rate_hz",
    "seconds",
    "source_rate_hz",
    "near_m",
    "far_m",
    "baseline_m",
]
OTHER = {
    "intrinsics": "1,2,3,4",
    "poses": "a.txt",
    "topic": "/depth",
    "pose_form": "inverted",
    "depth_encoding": "rotated",
    "frame": "camera",
    "world": "causal",
    "reading": "height",
    "shell": "one",
    "holes": "leave",
    "normals": "up",
    "interpolation": "nearest",
    "animation": "walk",
    "relative_depth": "a.png",
    "segment": "step=0.1",
    "disparity_offset_px": -3.0,
}


@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_that_is_not_above_0_is_refused_by_its_name(name: str) -> None:
    assert getattr(SourceOptions(**{name: 1e-3}), name) == 1e-3
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InvalidArgument, match=f"^{name}: found {wrong}"):
            SourceOptions(**{name: wrong})


def test_every_option_is_a_number_or_a_choice() -> None:
    assert {f.name for f in fields(SourceOptions)} == {*NUMBERS, *OTHER, "kind", "allow_outside"}
    for name in ("frame", "world", "reading", "shell", "holes", "normals", "interpolation", "depth_encoding"):
        assert getattr(SourceOptions(**{name: OTHER[name]}), name) == OTHER[name]
        with pytest.raises(InvalidArgument, match=f"{name}: found 'some'"):
            SourceOptions(**{name: "some"})
    with pytest.raises(InvalidArgument, match="poses: found poses with frame camera"):
        SourceOptions(poses="a.txt", frame="camera")
    with pytest.raises(InvalidArgument, match="pose_form: found a form of poses with frame camera"):
        SourceOptions(pose_form="inverted", frame="camera")


@pytest.mark.parametrize("name", [*NUMBERS, *OTHER])
def test_an_unread_option_is_detected(name: str) -> None:
    value = OTHER.get(name, 0.5)
    watched = WatchedOptions(SourceOptions(**{name: value}))
    assert watched.unread() == [name]
    others = [f.name for f in fields(SourceOptions) if f.name != name]
    assert [getattr(watched, other) for other in others] == [
        getattr(SourceOptions(), other) for other in others
    ]
    assert watched.unread() == [name]
    assert getattr(watched, name) == value and watched.unread() == []
    assert WatchedOptions(SourceOptions(kind="mesh", allow_outside=True)).unread() == []
