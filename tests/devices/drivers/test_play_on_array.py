"""A stream played on an array: the datagrams have the drives of the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from osc_listener import Listener, listening
from touchfield import pipeline
from touchfield.devices.drivers.registry import array_device
from touchfield.pipeline.array_medium import array_drives
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.array_player import ArrayPlayer
from touchfield.sources.tiny_scenes import tiny_scenes
from touchfield.tasks.play import PlaySpec, play

VEST = "tactile-vest-8x8"


def test_file_is_played_frame_by_frame(tmp_path: Path) -> None:
    path = tmp_path / "ramp.touch"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(device=VEST))
    with listening() as line, pipeline.open_file(path) as stream:
        array = array_device(f"osc:127.0.0.1:{line.getsockname()[1]}")
        frames = array_drives(stream, array.profile)
        with ArrayPlayer(frames, array, rate_hz=frames.rate_hz, speed=0.5) as player:
            assert player.wait(30)
        listener = Listener(array.profile)
        line.settimeout(0.2)
        try:
            while True:
                listener.take(line.recv(1 << 16))
        except TimeoutError:
            pass
        expected = [frames.drives(i) for i in range(len(frames))]
    assert max(drives.max() for drives in expected) > 0.1
    sent = [frame["drives"] for frame in listener.frames]
    # the last frame, and three end messages
    assert not sent[-1].any() and len(sent) == player.statistics()["sent"] + 4
    # at half the speed, frames are interpolated
    between = [
        *expected,
        *((a + b) / 2 for a, b in zip(expected, expected[1:])),
    ]
    for received in sent[:-4]:
        difference = min(float(np.abs(received - drives).max()) for drives in between)
        assert difference <= 0.5 / 255 + 1e-6 or not received.any()
    assert any(received.any() for received in sent)


@pytest.mark.parametrize(("stalled", "is_starved"), [(0, False), (1, True)])
def test_late_frames_for_an_array_are_reported(
    stalled: int, is_starved: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ramp.touch"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(device=VEST))
    original_statistics = ArrayPlayer.statistics
    monkeypatch.setattr(
        ArrayPlayer, "statistics", lambda self: {**original_statistics(self), "stalled": stalled, "sent": 4}
    )
    with listening() as line:
        played = play(path, PlaySpec(f"osc:127.0.0.1:{line.getsockname()[1]}", seconds=0.2))
    assert played.statistics["stalled_share"] == stalled / 4 and played.is_starved == is_starved
