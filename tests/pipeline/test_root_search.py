"""The search for a control value: few evaluations for any falling curve."""

from __future__ import annotations

import math

from hypothesis import given, strategies as st

from touchfield.pipeline.rate_control import RootSearch


@given(
    st.floats(-3.0, 3.0),
    st.floats(0.3, 3.0),
    st.floats(-0.12, 0.12),
    st.floats(-4.0, 4.0),
    st.floats(-0.002, 0.002),
)
def test_the_root_of_a_bent_curve_takes_few_evaluations(
    root: float, fall: float, bend: float, start: float, noise: float
) -> None:
    def value(x: float) -> float:
        return -fall * (x - root) * (1 + bend * math.tanh(x - root)) + noise * math.sin(1e4 * x)

    search = RootSearch(-10.0, 10.0, -1.0)
    assert search.run(value, start, lambda y: abs(y) < 0.015, 7)
    assert len(search.points) <= 7 and abs(search.points[-1][0] - root) < 0.2


def test_a_search_without_a_root_ends_at_the_bound() -> None:
    search = RootSearch(0.0, 5.0, -0.6)
    assert not search.run(lambda x: 10 - x, 1.0, lambda y: abs(y) < 0.01, 20)
    assert search.points[-1][0] == 5.0 and len(search.points) < 20
    search = RootSearch(0.0, 5.0, -0.6)
    assert not search.run(lambda x: -1 - x, 1.0, lambda y: abs(y) < 0.01, 20)
    assert search.points[-1][0] == 0.0


def test_a_flat_section_is_escaped() -> None:
    search = RootSearch(0.0, 10.0, -1.0)
    assert search.run(lambda x: 3.0 if x < 4 else 4.5 - x, 0.5, lambda y: abs(y) < 0.02, 9)
