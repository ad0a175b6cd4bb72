"""The plate of the tests of engines is one that the stored force alone does not keep a hand out of."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from builders import INTEGRATIONS, make_plate, press_plate, run

import touchfield as tf


def test_stored_force_does_not_resist_the_hand(tmp_path: Path) -> None:
    with tf.open_stream(make_plate(tmp_path / "plate.touch")) as stream:
        forces_n = tf.FieldSampler(stream.scene or stream.medium).force_n(0.0, press_plate())
    assert forces_n[:280, 2].max() > 0.1  # on its way in
    assert (forces_n[400:, 2] < 0.01).all()  # where `assert_resists` wants 0.5 N


def test_example_writes_the_plate_and_the_hand(tmp_path: Path) -> None:
    done = run(sys.executable, INTEGRATIONS / "plate.py", tmp_path)
    assert done.returncode == 0, done.stderr
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "press.txt"), press_plate())
    assert (tmp_path / "plate.touch").read_bytes() == make_plate(tmp_path / "again.touch").read_bytes()
