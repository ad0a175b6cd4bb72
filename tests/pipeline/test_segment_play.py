"""Segments from the encoder to the hand: their duration, and their starts in a static world."""

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
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.sources.stored import StoredScene

FAST = TouchSpec(effort="fast")
SPEC = EncodeSpec(nw=4, touch=FAST)
BALL = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),))


def noisy(frames: int, rate_hz: float, noise_n: float = 0.01) -> StoredScene:
    """A ball at rest with sensor noise within the mask: each force of each frame differs."""
    rng, noiseless = np.random.default_rng(3), prepare(BALL, SPEC).medium[0]
    fields = []
    for _ in range(frames):
        noise = rng.normal(0, noise_n, noiseless.forces_n.shape) * noiseless.mask[..., None]
        fields.append(ForceField.from_bricks(noiseless.grid, noiseless.bricks, noiseless.forces_n + noise))
    return StoredScene(HapticMedium.from_frames(fields, rate_hz, "x right, y up, z towards the viewer"))


@pytest.mark.parametrize(
    ("rate_hz", "frames"),
    [(0.1, 8), (15.0, 8), (30.0, 15), (32.0, 16), (60.0, 30), (125.0, 63), (1000.0, 64), (1e300, 64)],
)
def test_a_segment_lasts_half_a_second(rate_hz: float, frames: int) -> None:
    assert segment_length(None, rate_hz) == EncodeSpec().segment_frames_at(rate_hz) == frames
    assert segment_length(5, rate_hz) == 5
    assert EncodeSpec(coder="paper").segment_frames_at(rate_hz) == 8


def test_segments_of_a_file_depend_on_its_rate_or_the_option(tmp_path: Path) -> None:
    for rate_hz, segment_frames, lengths in (
        (60.0, None, [30, 3]),
        (30.0, None, [15, 15, 3]),
        (60.0, 10, [10, 10, 10, 3]),
    ):
        spec = replace(SPEC, touch=replace(FAST, segment_frames=segment_frames))
        encode(noisy(33, rate_hz), tmp_path / "a.touch", spec)
        with open_file(tmp_path / "a.touch") as opened:
            assert [s.frame_count for s in opened.reader.segments] == lengths
            segments = opened.medium.segments
            assert segments is not None and (segments.k, segments.f0_n) == (FAST.k, FAST.f0_n)
            assert segments.starts == tuple(s.first_frame for s in opened.reader.segments)
    with pytest.raises(InvalidArgument, match="segment_frames"):
        TouchSpec(segment_frames=0)


def test_a_repeated_frame_ends_no_segment(tmp_path: Path) -> None:
    first, second = (noisy(1, 30.0).stored[0], noisy(1, 30.0, 0.02).stored[0])
    frames = [first] * 40 + [second] + [first, second] * 10
    scene = StoredScene(HapticMedium.from_frames(frames, 30.0, "x right, y up, z towards the viewer"))
    for segment_frames, lengths in ((None, [30, 24, 7]), (8, [8] * 7 + [5])):
        encode(scene, tmp_path / "a.touch", replace(SPEC, touch=replace(FAST, segment_frames=segment_frames)))
        with open_file(tmp_path / "a.touch") as opened:
            assert [s.frame_count for s in opened.reader.segments] == lengths


@pytest.mark.parametrize("touch", [replace(FAST, mode="nmse"), replace(FAST, mode="mask-direction")])
def test_only_the_mode_mask_is_blended(tmp_path: Path, touch: TouchSpec) -> None:
    encode(noisy(9, 30.0), tmp_path / "a.touch", replace(SPEC, touch=replace(touch, segment_frames=8)))
    with open_file(tmp_path / "a.touch") as opened:
        assert opened.medium.segments is None
    hold = compare(noisy(9, 30.0), tmp_path / "a.touch").hand.hold
    assert hold is not None and hold.start_error_mn > 0


@pytest.mark.parametrize(("rate_hz", "frames", "max_fraction"), [(30.0, 31, 0.6), (1000.0, 129, 0.25)])
def test_the_blend_hides_segment_starts_of_a_static_world(
    tmp_path: Path, rate_hz: float, frames: int, max_fraction: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, scene = tmp_path / "a.touch", noisy(frames, rate_hz)
    encode(scene, path, SPEC)
    with open_file(path) as opened:
        before = [opened.medium[i] for i in range(frames)]
    holds = [compare(scene, path).hand.hold]
    monkeypatch.setattr(
        sys.modules["touchfield.pipeline.comparison"], "with_blends", lambda medium: (medium, ())
    )
    holds.append(compare(scene, path).hand.hold)  # each frame as decoded
    # the noise of the source is in every step; the blend removes the excess at the start of a segment
    added, decoded_added = (np.sqrt(max(0.0, h.start_error_mn**2 - h.error_step_mn**2)) for h in holds if h)
    assert decoded_added > 5 and added < max_fraction * decoded_added
    with open_file(path) as opened:
        step = 1 + frames // 32  # each frame is decoded from the start of its segment
        assert [opened.medium[i] for i in range(frames)[::-step]] == before[::-step]


def test_play_can_disable_the_blend(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, logs = tmp_path / "a.touch", [tmp_path / "with.csv", tmp_path / "without.csv"]
    encode(noisy(33, 60.0, 0.05), path, replace(SPEC, touch=replace(FAST, segment_frames=8)))
    where = tmp_path / "held.csv"
    where.write_text("t_s,x_m,y_m,z_m\n" + "".join(f"{t},0.0,0.0,0.022\n" for t in (0.0, 0.5)))
    for log, more in zip(logs, ([], ["--no-blend"])):
        arguments = [
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
        assert _exit_code(arguments) == 0
    capsys.readouterr()
    blended, unblended = (log.read_text().splitlines() for log in logs)
    assert len(blended) == len(unblended) > 400
    # the first segment lasts for 133 ticks; the columns up to the field's force and friction
    fields = [[row.split(",")[:13] for row in rows] for rows in (blended, unblended)]
    assert fields[0][:100] == fields[1][:100] and fields[0] != fields[1]
    assert blended[20:90] != unblended[20:90]  # the force fades in only with the blend
