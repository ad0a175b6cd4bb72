"""A stream from its file to the datagrams of an array: what the device gets is what the file holds."""

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


def test_a_file_is_felt_frame_by_frame(tmp_path: Path) -> None:
    path = tmp_path / "ramp.touch"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(device=VEST))
    with listening() as line, pipeline.open_stream(path) as stream:
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
        held = [frames.drives(i) for i in range(len(frames))]
    assert max(one.max() for one in held) > 0.1
    sent = [frame["drives"] for frame in listener.frames]
    assert (
        not sent[-1].any() and len(sent) == player.statistics()["sent"] + 4
    )  # the last frame, and three goodbyes
    between = [*held, *((a + b) / 2 for a, b in zip(held, held[1:]))]  # at half the speed
    for shown in sent[:-4]:
        near = min(float(np.abs(shown - one).max()) for one in between)
        assert near <= 0.5 / 255 + 1e-6 or not shown.any()
    assert any(shown.any() for shown in sent)


@pytest.mark.parametrize(("stalled", "is_starved"), [(0, False), (1, True)])
def test_frames_that_came_too_late_for_an_array_are_told(
    stalled: int, is_starved: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ramp.touch"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(device=VEST))
    own = ArrayPlayer.statistics
    monkeypatch.setattr(ArrayPlayer, "statistics", lambda self: {**own(self), "stalled": stalled, "sent": 4})
    with listening() as line:
        played = play(path, PlaySpec(f"osc:127.0.0.1:{line.getsockname()[1]}", seconds=0.2))
    assert played.statistics["stalled_share"] == stalled / 4 and played.is_starved == is_starved
