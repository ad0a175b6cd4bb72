"""The guess of a frame: which kind it is, and bytes of no kind."""

from __future__ import annotations

import numpy as np
import pytest
from test_columns import RULE, lattice_of, solid, turned
from test_spline import ball

from touchfield.codec.touch import guess
from touchfield.codec.touch.guess_fit import fit
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium import ForceField


@pytest.mark.parametrize(
    ("frame", "kind"), [(ball(), guess.SPLINE), (turned(solid(step=9, blurred=True), 2, True), guess.COLUMNS)]
)
def test_the_kind_of_a_field(frame, kind):
    found = fit(frame, lattice_of(frame), RULE)
    assert found is not None
    assert found[0][0] == kind
    assert np.array_equal(guess.synthesise(found[0], frame.grid).vectors, found[1].vectors)


def test_noise_has_no_guess():
    frame = ball()
    noise = np.random.default_rng(0).normal(size=frame.forces_n.shape).astype(np.float32)
    rough = ForceField.from_bricks(frame.grid, frame.bricks, noise)
    assert fit(rough, lattice_of(rough), RULE) is None


@pytest.mark.parametrize(("data", "error"), [(b"", TruncatedFile), (b"\2abc", CorruptFile), (b"\0", TruncatedFile)])
def test_bytes_of_no_kind_are_refused(data, error):
    with pytest.raises(error):
        guess.synthesise(data, ball().grid)
