"""Every bounded cache from both sides: cached results are not recomputed, and the bound holds.

Elsewhere: `tests/network/test_remote.py` (bytes of a remote file), `test_live_medium.py` (segments of a
receiver), `tests/pipeline/test_lookahead.py` (segments decoded in advance), `tests/render/test_arena.py`
(frames of the block).
"""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import encode, rate_control, segments
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.partition import SymbolFrames
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import DepthSequence, InterpolatedSequence, Intrinsics
from touchfield.sources.depth import fused_scene
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.depth.segmentation import Segmentation, SegmentRule
from touchfield.sources.laws import ForceProfile
from touchfield.sources.stored import StoredScene

GRID = Grid((16, 16, 16), (0.004,) * 3, (-0.03,) * 3)
WALL = ForceProfile(((-0.18, 0.0, 0.0, -18.0),))
AXES = "x right, y up, z towards the user"


class Counted:
    """Records the numbers of computed results, and counts the results still referenced."""

    def __init__(self, make: Callable[[int], Any]) -> None:
        self._make, self.numbers, self._alive = make, [], []  # type: ignore[var-annotated]

    def __call__(self, number: int) -> Any:
        self.numbers.append(number)
        result = self._make(number)
        self._alive.append(weakref.ref(result))
        return result

    @property
    def alive(self) -> int:
        return sum(reference() is not None for reference in self._alive)

    def take_numbers(self) -> list[int]:
        numbers, self.numbers = self.numbers, []
        return numbers


def field(number: int) -> ForceField:
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[4:12, 4:12, 4:12, 2] = 0.5 + number / 64
    return ForceField.from_dense(GRID, forces)


def medium(frames: int, make: Callable[[int], ForceField] = field) -> HapticMedium:
    return HapticMedium(GRID, 50.0, frames, make, AXES)


class Pictures(DepthSequence):
    """A slanted wall that comes nearer."""

    def __init__(self, count: int) -> None:
        self.name, self.intrinsics, self.rate_hz = "pictures", Intrinsics(20.0, 20.0, 9.5, 7.5), 10.0
        self.frame_count, self.width, self.height, self.notes = count, 20, 16, ()
        self.computed = Counted(
            lambda i: (2.0 - 0.01 * i + 0.002 * np.arange(20) + np.zeros((16, 1))).astype(np.float32)
        )

    def depth_m(self, frame: int) -> np.ndarray:
        depth: np.ndarray = self.computed(frame)
        return depth


@pytest.mark.parametrize("capacity", [0, 3, 100])
def test_frames_of_a_search_are_cached_within_their_memory(
    capacity: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rate_control, "_MAX_CACHE_BYTES", capacity * field(0).forces_n.nbytes)
    computed = Counted(field)
    prepared: Any = replace_medium(medium(8, computed))
    cached = rate_control._with_frame_cache(prepared).medium
    for _ in range(3):
        assert [cached[i] == field(i) for i in range(8)] == [True] * 8
    assert computed.take_numbers() == [*range(8), *(2 * list(range(min(capacity, 8), 8)))]
    assert computed.alive == min(capacity, 8)


def replace_medium(of: HapticMedium) -> Any:
    """The part of a prepared scene that `_with_frame_cache` uses."""
    from touchfield.pipeline import prepare

    return replace(prepare(StoredScene(medium(1)), EncodeSpec(nw=4)), medium=of)


def test_symbols_of_the_last_two_frames_are_cached() -> None:
    computed = Counted(field)
    quantise = FieldQuantiserSpec().fit([field(0), field(9)], 4.0)
    frames = SymbolFrames(medium(10, computed), quantise)
    pairs = [(frames[i], frames[i + 1]) for i in range(9)]
    assert computed.take_numbers() == list(range(10)), "frames in pairs, each made once"
    assert frames[9] is pairs[-1][1] and frames[8] is pairs[-1][0] and computed.take_numbers() == []
    symbols = [weakref.ref(reference) for pair in pairs for reference in pair]
    del pairs
    gc.collect()
    assert len({id(reference()) for reference in symbols if reference() is not None}) == 2
    assert frames[0] is not None and computed.take_numbers() == [0]


def test_interpolated_depth_caches_three_pictures() -> None:
    source = Pictures(12)
    faster = InterpolatedSequence(source, 25.0)
    for frame in range(faster.frame_count):
        faster.depth_m(frame)
        assert source.computed.alive <= 3
    assert source.computed.take_numbers() == list(range(12)), "in a pass each picture is read once"
    faster.depth_m(faster.frame_count - 3), faster.depth_m(faster.frame_count - 1)
    assert source.computed.take_numbers() == []
    faster.depth_m(0)
    assert source.computed.take_numbers() == [0]


def test_segmentation_caches_eight_frames() -> None:
    source = Pictures(20)
    objects = Segmentation(source, SegmentRule.parse("least=0.004"), 5e-4)
    source.computed.take_numbers()
    for frame in range(20):
        for number in (0, 0, 1):
            objects.depth_m(frame, number)
        assert source.computed.alive <= 8
    assert source.computed.take_numbers() == list(range(20)), "each object of a frame is cut from one reading"
    for frame in range(12, 20):
        objects.depth_m(frame, 0)
    assert source.computed.take_numbers() == []


def test_fused_worlds_are_cached_for_sixteen_lattices(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[Grid] = []

    class World:
        def __init__(self, grid: Grid, *_: Any) -> None:
            started.append(grid)

        def update(self, frame: int) -> int:
            return frame

        def notes(self) -> tuple[str, ...]:
            return ()

    monkeypatch.setattr(fused_scene, "_Fused", World)
    scene = FusedScene(Pictures(3))
    grids = [Grid((4, 4, 4), (0.1,) * 3, (0.0, 0.0, float(i))) for i in range(20)]
    for _ in range(2):
        for grid in grids[:16]:
            scene.field_update(0, grid, WALL)
    assert started == grids[:16], "an array asks for as many slabs again and again"
    for grid in grids[16:]:
        scene.field_update(0, grid, WALL)
    assert len(scene._worlds) == 16
    scene.field_update(0, grids[19], WALL)
    assert started == grids
    scene.field_update(0, grids[0], WALL)
    assert started == [*grids, grids[0]]


@pytest.mark.parametrize("capacity", [0, 4, 1000])
def test_planes_of_pictures_are_cached_within_their_memory(
    capacity: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fused_scene, "_MAX_PLANES_BYTES", 16 * 20 * 16 * capacity)
    scene = FusedScene(Pictures(10))
    computed: list[int] = []
    planes = scene.planes
    monkeypatch.setattr(scene, "planes", lambda frame: computed.append(frame) or planes(frame))
    for _ in range(2):
        for i in range(len(scene._planes.keys)):
            scene._planes[i]
    keys = [int(key) for key in scene._planes.keys]
    assert computed == [*keys, *keys[capacity:]]


@pytest.mark.parametrize("capacity", [0, 3, 1000])
def test_a_segment_ends_at_the_limit_of_its_memory(
    capacity: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(segments, "MAX_SEGMENT_BYTES", capacity * field(0).forces_n.nbytes)
    scene = StoredScene(HapticMedium.from_frames([field(i) for i in range(16)], 50.0, AXES))
    encode(scene, tmp_path / "a.touch", EncodeSpec(nw=4, touch=TouchSpec(effort="fast", segment_frames=8)))
    with open_file(tmp_path / "a.touch") as stream:
        counts = [segment.frame_count for segment in stream.reader.segments]
    assert sum(counts) == 16 and set(counts[:-1]) == {min(capacity + 1, 8)}


@pytest.mark.parametrize(("max_bytes", "waits"), [(24_000, False), (10_000_000, True)])
def test_datagrams_wait_for_a_lost_message_within_their_memory(
    max_bytes: int, waits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("raptorq", reason="datagrams need the extra broadcast")
    from touchfield.network import datagrams

    monkeypatch.setattr(datagrams, "_MAX_WAITING_BYTES", max_bytes)
    sender, gathering = datagrams.Datagrams(7), datagrams.Gathering()
    messages = [np.random.default_rng(i).bytes(4000) for i in range(12)]
    sent = [datagram for message in messages for datagram in sender.add(message)] + sender.flush()
    delivered = [datagram for datagram in sent if datagrams._parse(datagram, None).number != 1]  # type: ignore[union-attr]
    out = [message for datagram in delivered for message in gathering.receive(datagram)]
    if waits:
        assert out == messages[:1] and gathering.lost == 0
    else:
        assert out[-1] == messages[-1] and gathering.lost == len(messages) - len(out) > 0


def test_an_index_of_files_is_described_within_its_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from touchfield.tasks import library

    calls = []
    original = library.in_order

    def in_order(work: Any, items: Any, weight: Any, max_weight: int, executor: Any) -> Any:
        calls.append((max_weight, [weight(item) for item in items]))
        return original(work, items, weight, max_weight, executor)

    monkeypatch.setattr(library, "in_order", in_order)
    scene = StoredScene(HapticMedium.from_frames([field(0)], 50.0, AXES))
    for name in ("a", "b"):
        encode(scene, tmp_path / f"{name}.touch", EncodeSpec(nw=4, touch=TouchSpec(effort="fast")))
    library.index_folder(tmp_path, tmp_path.parent / "i.npz")
    sizes = [(tmp_path / f"{name}.touch").stat().st_size for name in ("a", "b")]
    assert calls == [(library.MAX_PENDING_BYTES, sizes)]
