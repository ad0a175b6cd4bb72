"""A source in memory that `encode` takes is taken by every other function of a source."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import touchfield as tf
from height_makers import data_array
from touchfield.errors import InvalidArgument
from touchfield.pipeline.comparison import compare, filter_report
from touchfield.pipeline.encoding import encode
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.live import open_sender
from touchfield.tasks.plan import PlanGrid, plan


def test_heights_of_xarray(tmp_path: Path) -> None:
    pytest.importorskip("xarray")
    heights, spec = data_array(units="m"), EncodeSpec(nw=4)
    encode(heights, tmp_path / "a.touch", spec)
    summary = compare(heights, tmp_path / "a.touch").summary()
    assert summary["nmse_db"] < -20
    prepared, sender = open_sender(heights, spec)
    expected = prepare(heights, spec).medium[0]
    np.testing.assert_array_equal(prepared.medium[0].to_dense(), expected.to_dense())
    assert sender is not None
    assert len(plan(heights, "1Mbit/s", spec, PlanGrid(nw=(4,))).summary()) > 0
    assert len(filter_report(heights, spec).summary()["stages"]) == 1
    with pytest.raises(InvalidArgument, match=r"^source: found a scene that lies elsewhere"):
        compare(10 * data_array(units="m")[:8], tmp_path / "a.touch")


def test_an_array_of_newtons(tmp_path: Path) -> None:
    grid = tf.Grid((8, 8, 8), (0.01, 0.01, 0.01), (0, 0, 0))
    forces = np.random.default_rng(1).uniform(-1, 1, (3, 8, 8, 8, 3)).astype(np.float32)
    encode(forces, tmp_path / "a.touch", grid=grid)
    assert compare(forces, tmp_path / "a.touch").summary()["nmse_db"] < -20
    prepared, _ = open_sender(forces, EncodeSpec(), grid)
    assert len(prepared.medium) == 3
    with pytest.raises(InvalidArgument, match=r"an array \(3, 8, 8, 8, 3\) without its grid"):
        open_sender(forces, EncodeSpec())
