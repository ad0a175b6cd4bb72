"""`play --check`: the decoded frames, the required rate, and the exit code."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import encode
from touchfield.pipeline.source import decode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.stored import StoredScene
from touchfield.tasks.play import check_play


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    forces = np.zeros((6, 6, 6, 3), np.float32)
    forces[..., 2] = 1.0
    grid = Grid((6, 6, 6), (0.01,) * 3, (-0.025,) * 3)
    fields = [ForceField.from_dense(grid, forces * (1 + n / 40)) for n in range(30)]
    path = tmp_path_factory.mktemp("check") / "long.touch"
    scene = StoredScene(HapticMedium.from_frames(fields, 30.0, "x right, y up, z towards the user"))
    encode(scene, path, EncodeSpec(nw=4, touch=TouchSpec(segment_frames=3)))
    return path


class Clock:
    """A clock that advances by a step at each reading."""

    def __init__(self, step_s: float) -> None:
        self.now_s, self.step_s = 0.0, step_s

    def __call__(self) -> float:
        self.now_s += self.step_s
        return self.now_s


def test_a_sample_of_segments_is_compared_with_real_time(stream: Path) -> None:
    quick, slow = check_play(stream, clock_s=Clock(0.01)), check_play(stream, clock_s=Clock(0.05))
    assert quick["frames_decoded"] == slow["frames_decoded"] == 24  # 8 of 10 segments
    assert quick["can_play"] and not slow["can_play"]
    assert slow["greatest_speed"] == pytest.approx(1 / 0.05 / 30 / 1.2, rel=0.1)
    assert check_play(stream, 0.5, Clock(0.05))["can_play"]
    assert check_play(stream, clock_s=Clock(8.0))["frames_decoded"] < 8  # bounded in time
    with pytest.raises(InvalidArgument, match="speed"):
        check_play(stream, 0.0)
    assert [check_play(stream, speed, Clock(0.05))["needed_rate_hz"] for speed in (1.0, 0.5)] == [30.0, 15.0]


def test_a_short_file_is_decoded_completely_and_a_static_one_always_plays(
    stream: Path, tmp_path: Path
) -> None:
    for count in (5, 1):
        encode(decode(stream)[:count], tmp_path / "a.touch", EncodeSpec(touch=TouchSpec(segment_frames=3)))
        assert check_play(tmp_path / "a.touch", clock_s=Clock(0.05))["frames_decoded"] == count
    result = check_play(tmp_path / "a.touch", clock_s=Clock(30.0))
    assert (result["frames_decoded"], result["needed_rate_hz"], result["can_play"]) == (1, 0.0, True)


def test_the_exit_code_states_the_result(
    stream: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import touchfield.tasks.play as job

    for can, code in ((True, 0), (False, 1)):
        monkeypatch.setattr(job, "check_play", lambda *_, can=can: {"can_play": can})
        assert _exit_code(["play", str(stream), "--check", "--json"]) == code
        assert json.loads(capsys.readouterr().out)["can_play"] is can
