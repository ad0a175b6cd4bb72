"""Segments from the coder to the hand: how long they are, and how a standing world is felt where one
starts.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.segment import segment_length
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, HapticMedium
from touchfield.pipeline import compare, encode, prepare
from touchfield.pipeline.decoding import open_stream
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.sources.stored import StoredScene

FAST = TouchSpec(effort="fast")
SPEC = EncodeSpec(nw=4, touch=FAST)
BALL = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),))


def noisy(frames: int, rate_hz: float, noise_n: float = 0.01) -> StoredScene:
    """A ball at rest as a sensor sees it: each force with noise of its own in each frame, within the mask."""
    rng, still = np.random.default_rng(3), prepare(BALL, SPEC).medium[0]
    made = []
    for _ in range(frames):
        noise = rng.normal(0, noise_n, still.forces_n.shape) * still.mask[..., None]
        made.append(ForceField.from_bricks(still.grid, still.bricks, still.forces_n + noise))
    return StoredScene(HapticMedium.from_frames(made, rate_hz, "x right, y up, z towards the viewer"))


@pytest.mark.parametrize(
    ("rate_hz", "frames"),
    [(0.1, 8), (15.0, 8), (30.0, 15), (32.0, 16), (60.0, 30), (125.0, 63), (1000.0, 64), (1e300, 64)],
)
def test_a_segment_lasts_half_a_second(rate_hz: float, frames: int) -> None:
    assert segment_length(None, rate_hz) == EncodeSpec().segment_frames_at(rate_hz) == frames
    assert segment_length(5, rate_hz) == 5
    assert EncodeSpec(coder="paper").segment_frames_at(rate_hz) == 8


def test_files_have_segments_by_their_rate_or_as_asked(tmp_path: Path) -> None:
    for rate_hz, asked, lengths in (
        (60.0, None, [30, 3]),
        (30.0, None, [15, 15, 3]),
        (60.0, 10, [10, 10, 10, 3]),
    ):
        spec = replace(SPEC, touch=replace(FAST, segment_frames=asked))
        encode(noisy(33, rate_hz), tmp_path / "a.touch", spec)
        with open_stream(tmp_path / "a.touch") as opened:
            assert [s.frame_count for s in opened.reader.segments] == lengths
            segments = opened.medium.segments
            assert segments is not None and (segments.k, segments.f0_n) == (FAST.k, FAST.f0_n)
            assert segments.starts == tuple(s.first_frame for s in opened.reader.segments)
    with pytest.raises(InvalidArgument, match="segment_frames"):
        TouchSpec(segment_frames=0)


def test_a_frame_that_repeats_the_one_before_ends_no_segment(tmp_path: Path) -> None:
    one, other = (noisy(1, 30.0).stored[0], noisy(1, 30.0, 0.02).stored[0])
    frames = [one] * 40 + [other] + [one, other] * 10
    scene = StoredScene(HapticMedium.from_frames(frames, 30.0, "x right, y up, z towards the viewer"))
    for asked, lengths in ((None, [30, 24, 7]), (8, [8] * 7 + [5])):
        encode(scene, tmp_path / "a.touch", replace(SPEC, touch=replace(FAST, segment_frames=asked)))
        with open_stream(tmp_path / "a.touch") as opened:
            assert [s.frame_count for s in opened.reader.segments] == lengths


@pytest.mark.parametrize("touch", [replace(FAST, mode="nmse"), replace(FAST, mode="mask-direction")])
def test_without_a_mask_that_is_a_ball_nothing_is_blended(tmp_path: Path, touch: TouchSpec) -> None:
    encode(noisy(9, 30.0), tmp_path / "a.touch", replace(SPEC, touch=replace(touch, segment_frames=8)))
    with open_stream(tmp_path / "a.touch") as opened:
        assert opened.medium.segments is None
    hold = compare(noisy(9, 30.0), tmp_path / "a.touch").hand.hold
    assert hold is not None and hold.start_error_mn > 0


@pytest.mark.parametrize(("rate_hz", "frames", "most"), [(30.0, 31, 0.6), (1000.0, 129, 0.25)])
def test_a_hand_on_a_standing_world_feels_no_start(
    tmp_path: Path, rate_hz: float, frames: int, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, scene = tmp_path / "a.touch", noisy(frames, rate_hz)
    encode(scene, path, SPEC)
    with open_stream(path) as opened:
        before = [opened.medium[i] for i in range(frames)]
    holds = [compare(scene, path).hand.hold]
    monkeypatch.setattr(sys.modules["touchfield.pipeline.comparison"], "with_blends", lambda felt: (felt, ()))
    holds.append(compare(scene, path).hand.hold)  # each frame as it was decoded
    # the noise of the source itself is in every step; what a start adds to the others is what the blend takes
    added, decoded_added = (np.sqrt(max(0.0, h.start_error_mn**2 - h.error_step_mn**2)) for h in holds if h)
    assert decoded_added > 5 and added < most * decoded_added
    with open_stream(path) as opened:
        step = 1 + frames // 32  # each frame is decoded from the first of its segment on
        assert [opened.medium[i] for i in range(frames)[::-step]] == before[::-step]


def test_the_player_can_leave_it_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, logs = tmp_path / "a.touch", [tmp_path / "with.csv", tmp_path / "without.csv"]
    encode(noisy(33, 60.0, 0.05), path, replace(SPEC, touch=replace(FAST, segment_frames=8)))
    where = tmp_path / "held.csv"
    where.write_text("t_s,x_m,y_m,z_m\n" + "".join(f"{t},0.0,0.0,0.022\n" for t in (0.0, 0.5)))
    for log, more in zip(logs, ([], ["--no-blend"])):
        asked = [
            "play",
            str(path),
            "--offline",
            "--trajectory",
            str(where),
            "--log",
            str(log),
            "--json",
            *more,
        ]
        assert _exit_code(asked) == 0
    capsys.readouterr()
    one, other = (log.read_text().splitlines() for log in logs)
    assert len(one) == len(other) > 400
    assert one[:100] == other[:100] and one != other  # the first segment lasts for 133 ticks
