"""A scene that MuJoCo moves in one process, felt live by a hand in another, through a network that loses."""

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


def test_a_hand_feels_what_falls_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long that takes: a play ends once its hand has felt enough, or with its time."""
    keep_up, least_n = LiveStream.keep_up, 0.05

    def felt_enough(live: LiveStream, player: Player) -> bool:
        greatest_n = np.linalg.norm(player.log()["force_n"], axis=1).max(initial=0.0)
        if player.statistics()["frames_used"] > 20 and greatest_n > least_n:
            raise KeyboardInterrupt  # as a user ends it
        return keep_up(live, player)

    monkeypatch.setattr(LiveStream, "keep_up", felt_enough)
    (tmp_path / "ball.toml").write_text(BALL)
    hand = tmp_path / "hand.csv"  # from above into the floor, in the metres of the scene
    hand.write_text("t_s,x_m,y_m,z_m\n0,0.02,0.02,0.05\n1,0.02,0.02,-0.006\n60,0.02,0.02,-0.006\n")
    done, port, notes = threading.Event(), free_port(), list[str]()
    relay = lossy(port, 0.05, done)
    words = [sys.executable, "-m", "touchfield", "live", str(tmp_path / "ball.toml"), "--nw", "4", "--loop"]
    command = [*words, "--port", "0", "--segment-s", "0.2", "--udp", f"127.0.0.1:{relay}"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as sender:
        try:
            assert sender.stderr is not None
            address = next(line for line in sender.stderr if line.startswith("ws://")).split()[0]
            threading.Thread(target=sender.stderr.read, daemon=True).start()
            felt = play(
                f"udp://127.0.0.1:{port}", PlaySpec("sim", seconds=60.0, trace=hand), on_note=notes.append
            )
            least_n = -1.0
            beside = play(address, PlaySpec("sim", seconds=60.0), on_note=notes.append)
        finally:
            sender.terminate()
            done.set()
    for played in (felt, beside):
        assert played.error is None, notes
        assert played.statistics["frames_used"] > 20, (played.statistics, notes)
    assert felt.statistics["greatest_force_n"] > 0.05, (felt.statistics, notes)
