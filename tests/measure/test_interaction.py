"""Traces of a hand, their files, visits, and the entropy along a trace."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import io, stats

from touchfield.errors import InvalidArgument, SourceError
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.interaction import interaction_entropy, visits
from touchfield.measure.quantity import FewSamplesWarning, Quantity
from touchfield.medium import Grid, trace as trace_module
from touchfield.medium.trace import Trace, read_trace

GRID = Grid((5, 12, 9), (0.01, 0.02, 0.005), (-0.02, 0.1, 0.0))
LOW_M, HIGH_M = GRID.box_m
inside_m = arrays(
    np.float64, st.tuples(st.integers(1, 80), st.just(3)), elements=st.floats(0.001, 0.999)
).map(lambda fraction: LOW_M + fraction * (HIGH_M - LOW_M))


def symbols_of(seed: int, alphabet: int = 4, quantiser: str = "given") -> FieldSymbols:
    rng = np.random.default_rng(seed)
    dense = rng.integers(0, alphabet, GRID.shape) * (rng.random(GRID.shape) < 0.5)
    return FieldSymbols.from_dense(GRID, dense, alphabet, quantiser)


def walk(samples: int, seed: int = 0) -> Trace:
    """A random walk inside the box of GRID, 1 kHz."""
    steps = np.random.default_rng(seed).normal(0, 0.02, (samples, 3)).cumsum(axis=0)
    return Trace.regular(LOW_M + (HIGH_M - LOW_M) * (0.5 + 0.499 * np.sin(steps)))


def quiet(trace: Trace, symbols: FieldSymbols | Sequence[FieldSymbols], **more: object) -> Quantity:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)
        return interaction_entropy(trace, symbols, **more)  # type: ignore[arg-type]


# -- visits ------------------------------------------------------------------------------------------------


@given(inside_m)
def test_visits_are_of_the_nearest_lattice_point(positions: NDArray[np.float64]) -> None:
    found = visits(Trace.regular(positions), GRID)
    axes = [np.abs(positions[:, a, None] - GRID.axis_m(a)) for a in range(3)]
    # for every sample, no lattice point is nearer than the assigned one
    for axis, distance in enumerate(axes):
        assert (distance.min(axis=1) <= GRID.spacing_m[axis] * (0.5 + 1e-9)).all()
    nearest = Counter(zip(*(d.argmin(axis=1).tolist() for d in axes)))
    shifted = Counter({tuple(p): n for p, n in zip(found.indices.tolist(), found.counts.tolist())})
    ties = sum(int((np.abs(np.diff(np.sort(d, axis=1)[:, :2], axis=1)) < 1e-12).sum()) for d in axes)
    assert (nearest - shifted).total() <= ties
    assert found.outside == 0 and found.counts.sum() == len(positions)
    keys = np.ravel_multi_index(tuple(found.indices.T), GRID.shape)
    assert (np.diff(keys) > 0).all()


def test_positions_outside_are_counted_separately() -> None:
    edge = np.array([LOW_M + 1e-9, LOW_M - 1e-9, HIGH_M - 1e-9, HIGH_M + 1e-9, [1e300, 0, 0], [-1e300] * 3])
    found = visits(Trace.regular(edge), GRID)
    assert (
        found.indices.tolist() == [[0, 0, 0], [4, 11, 8]]
        and found.counts.tolist() == [1, 1]
        and found.outside == 4
    )


# -- entropy -----------------------------------------------------------------------------------------------


@given(inside_m, st.integers(0, 5))
def test_interaction_entropy_agrees_with_its_definition(positions: NDArray[np.float64], seed: int) -> None:
    symbols = symbols_of(seed)
    trace = Trace.regular(positions)
    found = quiet(trace, symbols, interval=False)
    mu = visits(trace, GRID)
    weight = np.bincount(symbols.symbols_at(mu.indices), weights=mu.counts, minlength=4)
    assert found.value == pytest.approx(stats.entropy(weight, base=2), abs=1e-12)
    assert (found.weighting, found.unit, found.quantiser) == ("interaction", "bit/sample", "given")
    assert (found.samples, found.symbols) == (len(positions), np.count_nonzero(weight))


def test_trace_through_every_voxel_has_the_voxel_entropy() -> None:
    symbols = symbols_of(1)
    trace = Trace.regular(GRID.to_m(np.argwhere(np.ones(GRID.shape))))
    found = quiet(trace, symbols, interval=False)
    counts = np.bincount(symbols.to_dense().ravel())
    assert found.value == pytest.approx(stats.entropy(counts, base=2), abs=1e-12)


def test_stationary_trace_has_no_entropy() -> None:
    found = interaction_entropy(Trace.regular(np.tile(GRID.to_m([2, 3, 4]), (100, 1))), symbols_of(2))
    assert found.value == 0 and found.symbols == 1


def test_interval_uses_blocks_of_time() -> None:
    symbols = symbols_of(3)
    together = interaction_entropy(walk(4000), symbols, blocks=16)
    assert together == interaction_entropy(walk(4000), symbols, blocks=16)
    assert together.dependence is not None
    shuffled = np.random.default_rng(0).permutation(walk(4000).positions_m)
    shuffled_entropy = interaction_entropy(Trace.regular(shuffled), symbols, blocks=16)
    assert shuffled_entropy.value == pytest.approx(together.value, abs=1e-12)
    assert shuffled_entropy.interval is not None and shuffled_entropy.dependence is not None
    assert shuffled_entropy.dependence.correlation_length < 3
    assert together.dependence.correlation_length > 9 * shuffled_entropy.dependence.correlation_length


@pytest.mark.parametrize("estimator", ["plug-in", "miller-madow", "chao-wang-jost"])
def test_interval_is_limited_by_the_alphabet(estimator: str) -> None:
    rng = np.random.default_rng(1)
    symbols = FieldSymbols.from_dense(GRID, rng.integers(0, 2, GRID.shape), 2, "given")
    found = interaction_entropy(walk(1000), symbols, blocks=8, estimator=estimator).interval
    assert found is not None and 0 <= found.low < found.high <= 1
    rare = Trace.regular(np.concatenate([np.tile(GRID.to_m([2, 3, 4]), (990, 1)), walk(10).positions_m]))
    seldom = interaction_entropy(rare, symbols, estimator=estimator).interval
    assert seldom is None or 0 <= seldom.low < seldom.high


def test_short_trace_has_no_interval_and_a_note() -> None:
    found = quiet(walk(7), symbols_of(3))
    assert found.interval is None and any("no interval" in n for n in found.notes)


def test_few_samples_give_a_warning() -> None:
    with pytest.warns(FewSamplesWarning, match="few samples"):
        found = interaction_entropy(walk(30), symbols_of(3, alphabet=60), interval=False)
    assert any("few samples" in n for n in found.notes)


def test_another_estimator() -> None:
    plain, corrected = (
        quiet(walk(200), symbols_of(4, 40), estimator=e, interval=False) for e in ("plug-in", "miller-madow")
    )
    assert corrected.estimator == "miller-madow" and corrected.value > plain.value


def test_trace_partly_outside_is_noted() -> None:
    positions = np.concatenate([walk(300).positions_m, np.full((100, 3), 9.0)])
    found = interaction_entropy(Trace.regular(positions), symbols_of(5), interval=False)
    assert found.samples == 300 and found.notes == (
        "100 of 400 samples of the trace lie outside the box of the field and were left out",
    )
    assert not interaction_entropy(walk(300), symbols_of(5), interval=False).notes


def test_uneven_times_are_noted() -> None:
    trace = walk(300)
    times = trace.times_s + (np.arange(300) > 150) * 0.5
    found = interaction_entropy(Trace(times, trace.positions_m), symbols_of(5), interval=False)
    assert any("not sampled regularly" in n for n in found.notes)


# -- frames ------------------------------------------------------------------------------------------------


class RecordingFrames(list[FieldSymbols]):
    """Frames that record the requested indices."""

    def __init__(self, frames: list[FieldSymbols]) -> None:
        super().__init__(frames)
        self.numbers: list[int] = []

    def __getitem__(self, index: int) -> FieldSymbols:  # type: ignore[override]
        self.numbers.append(index)
        return super().__getitem__(index)


def test_frames_are_used_for_their_duration() -> None:
    frames = RecordingFrames([symbols_of(n) for n in range(6)])
    times = np.round(np.arange(-20, 60) * 0.01, 2)  # -0.2 s to 0.59 s, written with two decimals
    positions = walk(80).positions_m
    found = quiet(Trace(times, positions), frames, rate_hz=10.0, interval=False)
    symbols = [
        frames[n // 10].symbols_at(visits(Trace.regular(p[None]), GRID).indices)[0]
        for n, p in enumerate(positions[20:])
    ]
    assert found.value == pytest.approx(
        stats.entropy(list(Counter(map(int, symbols)).values()), base=2), abs=1e-12
    )
    assert found.samples == 60 and any("20 of 80" in n for n in found.notes)


def test_rounded_down_time_belongs_to_the_frame_that_starts_there() -> None:
    frames = [FieldSymbols.from_dense(GRID, np.full(GRID.shape, n), 3, "given") for n in (1, 2)]
    trace = Trace(np.array([0.03333333, 0.05]), GRID.to_m(np.array([[1, 1, 1], [1, 1, 1]])))
    assert quiet(trace, frames, rate_hz=30.0, interval=False).value == 0


def test_samples_outside_in_time_and_space_are_counted_separately() -> None:
    frames = [symbols_of(n) for n in range(6)]
    positions = walk(100).positions_m.copy()
    positions[[5, 30, 31, 32, 95]] = 9.0  # two of the five are outside in time as well
    times = np.arange(-10, 90) * 0.01  # ten samples too early, thirty too late
    found = quiet(Trace(times, positions), frames, rate_hz=10.0, interval=False)
    assert found.samples == 57
    assert [n for n in found.notes if "left out" in n] == [
        "40 of 100 samples of the trace are before the first frame or after the last and were left out",
        "3 of 100 samples of the trace lie outside the box of the field and were left out",
    ]


def test_unvisited_frames_are_not_computed() -> None:
    frames = RecordingFrames([symbols_of(n) for n in range(6)])
    trace = Trace(np.linspace(0.31, 0.39, 50), walk(50).positions_m)
    quiet(trace, frames, rate_hz=10.0, interval=False)
    assert set(frames.numbers) == {0, 3}


def test_mismatched_frames_are_refused() -> None:
    trace = walk(200)
    frames = [symbols_of(0), symbols_of(1, quantiser="another")]
    with pytest.raises(InvalidArgument, match="frame 1: found the quantiser another"):
        interaction_entropy(trace, frames, rate_hz=10.0)
    for rate in (None, 0.0, -5.0, np.nan, np.inf):
        with pytest.raises(InvalidArgument, match="rate_hz"):
            interaction_entropy(trace, frames, rate_hz=rate)
    with pytest.raises(InvalidArgument, match="symbols: found no frame"):
        interaction_entropy(trace, [], rate_hz=10.0)


def test_trace_outside_the_field_is_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"trace: found positions from \(9, 9, 9\) to .*none of them"):
        interaction_entropy(Trace.regular(np.full((10, 3), 9.0)), symbols_of(0))
    late = Trace(walk(10).times_s + 1.3e9, walk(10).positions_m)
    with pytest.raises(InvalidArgument, match=r"from 1.3e\+09 to 1.3e\+09 s"):
        interaction_entropy(late, [symbols_of(0)], rate_hz=30.0)


def test_too_few_blocks() -> None:
    with pytest.raises(InvalidArgument, match="blocks: found 7"):
        interaction_entropy(walk(100), symbols_of(0), blocks=7)


# -- traces and their files --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "positions", "message"),
    [
        ([], np.zeros((0, 3)), "positions_m: found shape"),
        ([0.0], np.zeros((1, 2)), "positions_m: found shape"),
        ([0.0, 1.0], np.zeros((1, 3)), "times_s: found shape"),
        ([0.0, np.nan], np.zeros((2, 3)), "times_s: found nan at sample 1"),
        ([0.0], [[0, 0, np.inf]], "positions_m: found inf at sample 0"),
        ([0.0, 1.0, 0.5], np.zeros((3, 3)), "times_s: found 0.5 s after 1.0 s at sample 2"),
    ],
)
def test_invalid_traces_are_refused(times: object, positions: object, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        Trace(times, positions)  # type: ignore[arg-type]


def test_trace_copies_its_arrays() -> None:
    positions = np.zeros((2, 3))
    trace = Trace.regular(positions, 50.0)
    positions[:] = 1
    assert not trace.positions_m.any() and trace.times_s.tolist() == [0, 0.02]
    with pytest.raises(ValueError, match="read-only"):
        trace.positions_m[0] = 1
    with pytest.raises(InvalidArgument, match="rate_hz"):
        Trace.regular(positions, 0)


EXPECTED = Trace(np.array([0.0, 0.002]), np.array([[0.001, 0.002, 0.003], [0.004, -0.005, 0.006]]))


@pytest.mark.parametrize(
    "text",
    [
        "t_s,x_m,y_m,z_m\n0,0.001,0.002,0.003\n0.002,.004,-5e-3,6e-3\n",
        "x_mm,y_mm,z_mm,t_ms\n1,2,3,0\n4,-5,6,2\n",
        "x_µm,y_cm,z_mm,time_ns\n1000,0.2,3,0\n4000,-0.5,6,2000000\n",
        "\ufeffforce_n;Time [us];X (cm);temp;y_m;z_um\r\n9;0;0.1;;0.002;3000\r\n9;2000;0.4;hot;-0.005;6000",
        '# a tool\n"t_s"\t"x_m"\t"y_m"\t"z_m"\n\n"0"\t"0.001"\t0.002\t0.003\n# b\n '
        "0.002\t0.004\t-0.005\t0.006\n\n",
    ],
)
def test_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "trace.csv"
    path.write_bytes(text.encode())
    found = read_trace(path)
    assert found.times_s == pytest.approx(EXPECTED.times_s)
    assert found.positions_m == pytest.approx(EXPECTED.positions_m)


def test_file_without_times_uses_the_given_rate(tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_text("x_m,y_m,z_m\n" + "0,0,0\n" * 4)
    assert read_trace(path).times_s == pytest.approx([0, 0.001, 0.002, 0.003])
    assert read_trace(path, rate_hz=500.0).times_s == pytest.approx([0, 0.002, 0.004, 0.006])
    with pytest.raises(InvalidArgument, match="rate_hz"):
        read_trace(path, rate_hz=-1)


@given(arrays(np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=st.floats(-1e6, 1e6)))
def test_trace_round_trip(tmp_path_factory: pytest.TempPathFactory, positions: NDArray[np.float64]) -> None:
    path = tmp_path_factory.mktemp("traces") / "trace.csv"
    trace = Trace.regular(positions)
    rows = np.column_stack([trace.times_s, positions])
    path.write_text("t_s,x_m,y_m,z_m\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist()))
    assert read_trace(path) == trace


HEAD = "t_s,x_m,y_m,z_m\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found an empty file"),
        ("\n# nothing\n", "found an empty file"),
        (HEAD, "found a header and no sample"),
        ("0,1,2,3\n", "line 1: found no column for x, y, z in '0,1,2,3'"),
        ("x_m,y_m\n1,2\n", "line 1: found no column for z"),
        ("x,y,z\n1,2,3\n", "line 1: found column 'x'; expected x_ and one of m, cm, mm, um"),
        ("x_m,y_m,z_s\n1,2,3\n", "line 1: found column 'z_s'"),
        (
            "timestamp,x_m,y_m,z_m\n1,2,3,4\n",
            "line 1: found column 'timestamp'; expected t_ and one of s, ms",
        ),
        ("x_m,y_m,z_m,x_mm\n1,2,3,4\n", "line 1: found two columns for x"),
        (HEAD + "0,1,2,3\n\n1,1,2\n", "line 4: found 3 columns; expected at least 4"),
        (HEAD + "0,1,2,3\n1,1,two,3\n", "line 3, column y: found 'two'; expected a finite number"),
        (HEAD + "0,1,2,nan\n", "line 2, column z: found 'nan'"),
        (HEAD + "0,1,2,3\n" * 9 + "0,inf,2,3\n", "line 11, column x: found 'inf'"),
        (HEAD + "0,1_0,2,3\n", "line 2, column x: found '1_0'"),
        (HEAD + "0,,2,3\n", "line 2, column x: found ''"),
        (HEAD + "0,1,2,3\n# a\n0.5,1,2,3\n0.2,1,2,3\n", "line 5: found 0.2 s after 0.5 s"),
        ("\0\1\2\3" * 100, "line 1: found no column for x, y, z"),
        (HEAD + "1" * 70000, "line 2: found a line without end"),
    ],
)
def test_invalid_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "trace.csv"
    path.write_text(text)
    with pytest.raises(SourceError, match=r"trace\.csv") as caught:
        read_trace(path)
    assert message in str(caught.value)


def test_missing_files_are_refused(tmp_path: Path) -> None:
    for path, message in ((tmp_path, "found a folder"), (tmp_path / "none.csv", "found no such file")):
        with pytest.raises(SourceError, match=message):
            read_trace(path)


def test_a_file_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "trace.csv"
    path.write_text(HEAD + "0,1,2,3\n" * 101)
    monkeypatch.setattr(trace_module, "MAX_SAMPLES", 100)
    with pytest.raises(SourceError, match="more than 100 samples"):
        read_trace(path)


# -- a real hand -------------------------------------------------------------------------------------------


@pytest.mark.shared
def test_recorded_hand_meets_more_entropy_than_all_voxels(shared_data: Path, tmp_path: Path) -> None:
    """Two recordings of one person: forces of the first make a field, the second is a trace in it."""
    recordings = io.loadmat(
        shared_data / "force_panda_comanipulation" / "symbol_data.mat",
        squeeze_me=True,
        struct_as_record=False,
    )["symbol_data"]
    first, second = recordings[4], recordings[5]
    margin_m = np.array([1e-4, 1e-4, 1e-3])  # the sheet of paper is flat
    low, high = first.pos.min(axis=1) - margin_m, first.pos.max(axis=1) + margin_m
    grid = Grid.over_box(low, high, (24, 40, 1))
    mu = visits(Trace.regular(first.pos.T, 700.0), grid)
    assert mu.counts.sum() == first.pos.shape[1] and mu.outside == 0

    cell = np.floor(grid.to_index(first.pos.T) + 0.5).astype(int)
    total, visited = np.zeros(grid.shape), np.zeros(grid.shape)
    np.add.at(total, tuple(cell.T), np.linalg.norm(first.F, axis=0))
    np.add.at(visited, tuple(cell.T), 1)
    newtons = np.divide(total, visited, out=np.zeros(grid.shape), where=visited > 0)
    symbols = FieldSymbols.from_dense(
        grid, np.ceil(newtons / 0.5).astype(int), 20, "mean |F| in steps of 0.5 N"
    )

    path = tmp_path / "hand.csv"
    rows = np.column_stack([np.arange(second.pos.shape[1]) / 0.7, 1e3 * second.pos.T])
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="t_ms,x_mm,y_mm,z_mm", comments="")
    hand = read_trace(path)
    assert len(hand) == 15523 and hand.positions_m == pytest.approx(second.pos.T, rel=1e-14)

    met = interaction_entropy(hand, symbols, blocks=16)
    mu = visits(hand, grid)
    assert 0 < mu.outside < 0.3 * len(hand) and met.samples == len(hand) - mu.outside
    weight = np.bincount(symbols.symbols_at(mu.indices), weights=mu.counts)
    assert met.value == pytest.approx(stats.entropy(weight, base=2), abs=1e-12)
    assert met.interval is None or met.interval.low < met.value < met.interval.high
    assert met.dependence is not None and met.dependence.correlation_length > 100
    everywhere = stats.entropy(np.bincount(symbols.to_dense().ravel()), base=2)
    assert met.value > everywhere + 0.5  # a hand stays where forces vary


def test_trace_with_orientations(tmp_path: Path) -> None:
    path = tmp_path / "turned.csv"
    path.write_text("qx,t_s,qw,x_m,y_m,z_m,qz,qy\n0.6,0,0.8,1,2,3,0,0\n0,1,0,1,2,3,1.01,0\n")
    trace = read_trace(path)
    assert trace.quaternions is not None
    assert trace.quaternions == pytest.approx(np.array([[0.8, 0.6, 0, 0], [0, 0, 0, 1]]))
    assert trace == read_trace(path) and trace != Trace(trace.times_s, trace.positions_m)
    for text, message in (
        ("x_m,y_m,z_m,qw,qx,qy\n1,2,3,1,0,0\n", "all of qw"),
        ("x_m,y_m,z_m,qw,qx,qy,qz\n1,2,3,0,0,0,0\n", "length 0"),
    ):
        path.write_text(text)
        with pytest.raises(SourceError, match=message):
            read_trace(path)
    with pytest.raises(InvalidArgument, match="length 1"):
        Trace(np.zeros(1), np.zeros((1, 3)), np.ones((1, 4)))
