"""Bodies that come to rest keep their poses, bit for bit; bodies that are slow for other reasons move on."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import touchfield as tf
from touchfield.medium import HapticMedium, PoseTrack
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.rest import RestWatch
from touchfield.sources.physics.toml_file import open_physics

pytest.importorskip("mujoco", reason='needs the simulator: pip install "touchfield[physics]"')

HALF_M = 0.02
FLOOR = "[floor]"
BOX = f'[[body]]\nname = "box"\nkind = "box"\nhalf_extents_m = [{HALF_M}, {HALF_M}, {HALF_M}]\n'
BALL = f'[[body]]\nname = "ball"\nkind = "sphere"\nradius_m = {HALF_M}\n'

Make = Callable[..., BodyScene]


@pytest.fixture
def scene(tmp_path: Path) -> Make:
    def make(*parts: str) -> BodyScene:
        (tmp_path / "scene.toml").write_text("\n".join(parts))
        return open_physics(tmp_path / "scene.toml", SourceOptions())

    return make


def physics(seconds: float, **keys: Any) -> str:
    return "\n".join(["[physics]", f"seconds = {seconds}", *(f"{key} = {keys[key]}" for key in keys)])


def rest_frame(track: PoseTrack) -> int:
    """The frame from which on no bit of the pose changes."""
    poses = np.hstack([track.positions_m, track.quaternions])
    moves = np.flatnonzero((np.diff(poses, axis=0) != 0).any(axis=1))
    return int(moves[-1]) + 1 if len(moves) else 0


def test_a_fallen_body_keeps_its_pose(scene: Make) -> None:
    fallen = scene(physics(1.0), FLOOR, BOX, "position_m = [0, 0, 0.03]\nrotation_deg = [10, 5, 0]")
    track = fallen.bodies()[0].track
    assert 100 < rest_frame(track) < 900
    assert abs(track.positions_m[-1, 2] - HALF_M) < 1e-3


def test_a_simulation_ends_when_all_bodies_sleep(scene: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is left has the poses that more steps would have given."""
    parts = physics(1.5), FLOOR, BOX, "position_m = [0, 0, 0.03]", BALL, "position_m = [0.1, 0, 0.05]"
    updates = list[int]()
    update = RestWatch.update

    def counted(self: RestWatch, data: Any) -> None:
        updates.append(1)
        update(self, data)

    monkeypatch.setattr(RestWatch, "update", counted)
    ended = [body.track for body in scene(*parts).bodies()]
    assert 100 < len(updates) < 1200
    monkeypatch.setattr(RestWatch, "is_over", lambda self, data: False)
    updates.clear()
    stepped = [body.track for body in scene(*parts).bodies()]
    assert len(updates) == 1499
    for one, other in zip(ended, stepped, strict=True):
        assert one.positions_m.tobytes() == other.positions_m.tobytes()
        assert one.quaternions.tobytes() == other.quaternions.tobytes()


@pytest.mark.parametrize("step_s", [1e-3, 2e-5])
def test_a_body_that_turns_back_in_the_air_falls(scene: Make, step_s: float) -> None:
    thrown = scene(
        physics(0.2, rate_hz=1000, step_s=step_s), BALL, "position_m = [0, 0, 1]\nvelocity_m_s = [0, 0, 1]"
    )
    times_s = np.arange(200) / 1000
    expected_m = 1 + times_s - 9.81 * times_s**2 / 2
    assert np.abs(thrown.bodies()[0].track.positions_m[:, 2] - expected_m).max() < 2 * step_s


def test_a_body_that_slowly_begins_to_slide_is_not_stopped(scene: Make) -> None:
    world = physics(0.5, step_s=1e-4, friction=0, gravity_m_s2=[0.05, 0, -9.81])
    track = scene(world, FLOOR, BOX, f"position_m = [0, 0, {HALF_M}]").bodies()[0].track
    assert track.positions_m[-1, 0] == pytest.approx(0.05 * 0.5**2 / 2, rel=0.02)


def test_a_slow_body_that_touches_nothing_moves_on(scene: Make) -> None:
    world = physics(0.5, gravity_m_s2=[0, 0, 0])
    track = scene(world, BALL, "position_m = [0, 0, 1]\nvelocity_m_s = [0.0005, 0, 0]").bodies()[0].track
    assert track.positions_m[-1, 0] == pytest.approx(0.0005 * 0.499, rel=1e-6)


def test_a_slow_posed_body_carries_what_lies_on_it(scene: Make, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n1,0.0005,0,0\n")
    table = '[[body]]\nname = "table"\nkind = "box"\nhalf_extents_m = [0.1, 0.1, 0.02]\nposes = "table.csv"'
    box, _ = scene(physics(1.0), BOX, "position_m = [0, 0, 0.04]", table).bodies()
    assert box.track.positions_m[-1, 0] == pytest.approx(0.0005, rel=0.1)


def test_a_body_that_is_hit_wakes(scene: Make) -> None:
    hit = scene(
        physics(1.0), FLOOR, BOX, f"position_m = [0, 0, {HALF_M}]", BALL,
        "position_m = [-0.5, 0, 0.02]\nvelocity_m_s = [1, 0, 0]",
    )  # fmt: skip
    track = hit.bodies()[0].track
    assert (track.positions_m[250:400] == track.positions_m[250]).all(), "it sleeps until then"
    assert track.positions_m[-1, 0] > 0.005


def test_a_live_simulation_rests_and_wakes_as_a_file_does(scene: Make) -> None:
    fallen = scene(physics(0.6), FLOOR, BOX, "position_m = [0, 0, 0.03]")
    track = fallen.bodies()[0].track
    assert fallen.simulation is not None and rest_frame(track) < 500
    live = fallen.simulation()
    for _ in range(2):
        live.restart()
        positions_m = np.array([live.next_poses()[1][0] for _ in range(600)])
        assert positions_m.tobytes() == track.positions_m.tobytes()

    def push(model: Any, data: Any) -> None:
        data.xfrc_applied[1, 0] = 5.0

    live.control = push
    pushed_m = [live.next_poses()[1][0, 0] for _ in range(100)]
    assert pushed_m[-1] > positions_m[-1, 0] + 1e-3


def test_bodies_at_rest_have_one_field(scene: Make) -> None:
    rate_hz, seconds = 200, 1.5
    fallen = scene(physics(seconds, rate_hz=rate_hz), FLOOR, BOX, "position_m = [0, 0, 0.03]")
    rest = max(rest_frame(body.track) for body in fallen.bodies())
    spec = EncodeSpec(nw=4, representation="voxel")
    medium = tf.prepare(fallen, spec).medium
    assert medium[rest - 2] is not medium[rest - 1]
    fields = [medium[frame] for frame in range(rest + 1, len(medium))]
    assert len(fields) > 2 * 64, "more than two segments"
    assert all(field is later for field, later in pairwise(fields))


def test_the_decoded_field_of_bodies_at_rest_does_not_change(scene: Make, tmp_path: Path) -> None:
    fallen = scene(physics(1.5, rate_hz=200), FLOOR, BOX, "position_m = [0, 0, 0.03]")
    rest = max(rest_frame(body.track) for body in fallen.bodies())
    tf.encode(fallen, tmp_path / "rest.touch", EncodeSpec(nw=4, representation="voxel"))
    decoded = tf.decode(tmp_path / "rest.touch")
    assert isinstance(decoded, HapticMedium) and decoded.segments is not None
    starts = [start for start in decoded.segments.starts if start > rest]
    assert starts
    # the segment in which they come to rest has another key frame than those after it
    first, *others = (decoded[frame] for frame in range(starts[0], len(decoded)))
    assert all(np.array_equal(first.bricks, field.bricks) for field in others)
    assert all(first.forces_n.tobytes() == field.forces_n.tobytes() for field in others)
