"""A scene simulated by MuJoCo in one process, played live in another through a lossy network."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from tests.network.test_datagrams import free_port, lossy

from touchfield.network.live_medium import LiveStream
from touchfield.render.player import Player
from touchfield.tasks.play import PlaySpec, play

pytest.importorskip("mujoco", reason="falling bodies need the extra physics")

BALL = """
[physics]
seconds = 1.0
rate_hz = 25.0
[floor]
height_m = 0.0
[[body]]
name = "ball"
kind = "sphere"
radius_m = 0.05
position_m = [0.0, 0.0, 0.2]
"""


def test_a_falling_body_of_another_process_is_played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent of the machine's speed: play ends once the hand has felt enough, or with its time."""
    keep_up, min_force_n = LiveStream.keep_up, 0.05

    def has_enough(live: LiveStream, player: Player) -> bool:
        greatest_n = np.linalg.norm(player.log()["force_n"], axis=1).max(initial=0.0)
        if player.statistics()["frames_used"] > 20 and greatest_n > min_force_n:
            raise KeyboardInterrupt  # as a user does
        return keep_up(live, player)

    monkeypatch.setattr(LiveStream, "keep_up", has_enough)
    (tmp_path / "ball.toml").write_text(BALL)
    hand = tmp_path / "hand.csv"  # from above into the floor, in the metres of the scene
    hand.write_text("t_s,x_m,y_m,z_m\n0,0.02,0.02,0.05\n1,0.02,0.02,-0.006\n60,0.02,0.02,-0.006\n")
    done, port, notes = threading.Event(), free_port(), list[str]()
    relay = lossy(port, 0.05, done)
    program = [sys.executable, "-m", "touchfield", "live", str(tmp_path / "ball.toml"), "--nw", "4", "--loop"]
    command = [*program, "--port", "0", "--segment-s", "0.2", "--udp", f"127.0.0.1:{relay}"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as sender:
        try:
            assert sender.stderr is not None
            address = next(line for line in sender.stderr if line.startswith("ws://")).split()[0]
            threading.Thread(target=sender.stderr.read, daemon=True).start()
            by_datagrams = play(
                f"udp://127.0.0.1:{port}", PlaySpec("sim", seconds=60.0, trace=hand), on_note=notes.append
            )
            min_force_n = -1.0
            by_websocket = play(address, PlaySpec("sim", seconds=60.0), on_note=notes.append)
        finally:
            sender.terminate()
            done.set()
    for played in (by_datagrams, by_websocket):
        assert played.error is None, notes
        assert played.statistics["frames_used"] > 20, (played.statistics, notes)
    assert by_datagrams.statistics["greatest_force_n"] > 0.05, (by_datagrams.statistics, notes)
