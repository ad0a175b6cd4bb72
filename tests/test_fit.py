"""What is fitted into the workspace: the frames that are asked for, with a margin, and a note that says so."""

from __future__ import annotations

import numpy as np
import pytest

from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.job import EncodeSpec, prepare
from touchfield.medium import PoseTrack
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.body_scene import BodyScene
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth_scene import DepthScene
from touchfield.sources.height_scene import HeightScene
from touchfield.sources.scene import Body, Scene
from touchfield.sources.shapes import Box, Sphere


class Receding(DepthSequence):
    """A slanted wall that is at 1 m in frame 0 and 1 m farther in each frame that follows."""

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
def test_the_frames_that_are_taken_are_those_that_are_fitted(make) -> None:
    whole = prepare(make(), EncodeSpec(nw=4))
    part = prepare(make(), EncodeSpec(nw=4, frames=(0, 1)))
    as_whole = prepare(make(), EncodeSpec(nw=4, frames=(0, 1), fit_frames=(0, None)))
    other = prepare(make(), EncodeSpec(nw=4, fit_frames=(0, 1)))
    assert part.placement.scale > 1.2 * whole.placement.scale
    assert as_whole.placement == whole.placement and len(as_whole.medium) == 1
    assert other.placement == part.placement and len(other.medium) == 4
    assert any("in frames 0 to 3 fits" in note for note in whole.notes)
    assert any("in frames 0 to 0 fits" in note and "3.5 mm of it left on every side" in note for note in part.notes)


def test_a_scan_that_fills_the_depth_has_its_face_inside_the_workspace() -> None:
    box = AnalyticScene((Box((0.0, 0.0, 0.0), (0.02, 0.02, 0.05)),))
    made = prepare(box, EncodeSpec(nw=6))
    face_mm = 1e3 * made.placement.scale * 0.05
    assert face_mm == pytest.approx(35 - 3.5)  # of the Omni's 70 mm
    ahead = made.medium[0].sample_n([[0, 0, 0.0345], [0, 0, 0.030]])
    assert not ahead[0].any() and ahead[1, 2] > 0  # a hand can be before the face, and is pushed back behind it
    filled = prepare(box, EncodeSpec(nw=6, mapping="fill"))
    assert 2 * filled.placement.scale * 0.05 == pytest.approx(device("phantom-omni").workspace_m[2])


@pytest.mark.parametrize(("spec", "words"), [({"frames": (2, 9)}, "2:9"), ({"fit_frames": (4, None)}, "4:4")])
def test_frames_that_are_not_there_are_refused(spec: dict, words: str) -> None:
    with pytest.raises(InvalidArgument, match=rf"{words}.*within 0:4"):
        prepare(DepthScene(Receding()), EncodeSpec(nw=4, **spec))
    assert EncodeSpec.from_json(EncodeSpec(fit_frames=(1, None)).to_json()).fit_frames == (1, None)
