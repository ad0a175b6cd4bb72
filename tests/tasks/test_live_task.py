"""Frames sent by `live`: each frame of the source once, for any duration of the broadcast."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import touchfield as tf
from touchfield.tasks.live import LiveSpec, broadcast, open_sender

GRID = tf.Grid((8, 8, 8), (0.002,) * 3, (0.0,) * 3)


@pytest.mark.parametrize(
    ("spec", "frame_count"),
    [
        (LiveSpec(0.1), 7),
        (LiveSpec(0.1, seconds=10.0), 7),  # longer than the source
        (LiveSpec(0.1, seconds=0.2), 4),
        (LiveSpec(0.1, loop=True, seconds=0.5), 10),
    ],
)
def test_a_source_ends_unless_it_loops(spec: LiveSpec, frame_count: int, tmp_path: Path) -> None:
    forces_n = np.zeros((7, 8, 8, 8, 3))
    forces_n[:, 2:6, 2:6, 2:6, 2] = np.arange(1, 8)[:, None, None, None]
    path = tf.write_field(tmp_path / "seven.npz", tf.HapticMedium.from_array(forces_n, GRID, 20.0))
    prepared, sender = open_sender(str(path), tf.EncodeSpec(nw=3))
    clock_s = [0.0]
    wait = lambda seconds: clock_s.append(clock_s[-1] + seconds)  # noqa: E731
    sent = broadcast(prepared, sender.add, spec, clock_s=lambda: clock_s[-1], pause=wait)
    assert sent.frames + sent.left_out == frame_count  # frames that were encoded too late count as well
