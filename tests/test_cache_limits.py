"""Every cache with a limit, from both sides: what it keeps is not made again, and it keeps no more than it
may.

Elsewhere: `tests/network/test_remote.py` (bytes of a file elsewhere), `test_live_medium.py` (segments of a
receiver), `tests/pipeline/test_frames_ahead.py` (segments decoded ahead), `tests/render/test_arena.py`
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
from touchfield.pipeline.decoding import open_stream
from touchfield.pipeline.mapping import SymbolFrames
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import DepthSequence, InterpolatedSequence, Intrinsics
from touchfield.sources.depth import fused_scene
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.depth.segments import Segmentation, SegmentRule
from touchfield.sources.laws import ForceProfile
from touchfield.sources.stored import StoredScene

GRID = Grid((16, 16, 16), (0.004,) * 3, (-0.03,) * 3)
WALL = ForceProfile(((-0.18, 0.0, 0.0, -18.0),))
AXES = "x right, y up, z towards the user"


class Made:
    """Counts what is made by its number, and what of it is still somewhere."""

    def __init__(self, make: Callable[[int], Any]) -> None:
        self._make, self.numbers, self._alive = make, [], []  # type: ignore[var-annotated]

    def __call__(self, number: int) -> Any:
        self.numbers.append(number)
        made = self._make(number)
        self._alive.append(weakref.ref(made))
        return made

    @property
    def alive(self) -> int:
        return sum(one() is not None for one in self._alive)

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
        self.made = Made(
            lambda i: (2.0 - 0.01 * i + 0.002 * np.arange(20) + np.zeros((16, 1))).astype(np.float32)
        )

    def depth_m(self, frame: int) -> np.ndarray:
        depth: np.ndarray = self.made(frame)
        return depth


@pytest.mark.parametrize("room", [0, 3, 100])
def test_frames_of_a_search_are_kept_as_far_as_memory_allows(
    room: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rate_control, "_MAX_CACHE_BYTES", room * field(0).forces_n.nbytes)
    made = Made(field)
    prepared: Any = replace_medium(medium(8, made))
    kept = rate_control._with_frame_cache(prepared).medium
    for _ in range(3):
        assert [kept[i] == field(i) for i in range(8)] == [True] * 8
    assert made.take_numbers() == [*range(8), *(2 * list(range(min(room, 8), 8)))]
    assert made.alive == min(room, 8)


def replace_medium(of: HapticMedium) -> Any:
    """What `_with_frame_cache` takes of a prepared scene."""
    from touchfield.pipeline import prepare

    return replace(prepare(StoredScene(medium(1)), EncodeSpec(nw=4)), medium=of)


def test_of_symbols_the_last_two_frames_are_kept() -> None:
    made = Made(field)
    quantise = FieldQuantiserSpec().fit([field(0), field(9)], 4.0)
    frames = SymbolFrames(medium(10, made), quantise)
    pairs = [(frames[i], frames[i + 1]) for i in range(9)]
    assert made.take_numbers() == list(range(10)), "frames in pairs, each made once"
    assert frames[9] is pairs[-1][1] and frames[8] is pairs[-1][0] and made.take_numbers() == []
    symbols = [weakref.ref(one) for pair in pairs for one in pair]
    del pairs
    gc.collect()
    assert len({id(one()) for one in symbols if one() is not None}) == 2
    assert frames[0] is not None and made.take_numbers() == [0]


def test_of_depth_that_is_interpolated_three_pictures_are_kept() -> None:
    source = Pictures(12)
    faster = InterpolatedSequence(source, 25.0)
    for frame in range(faster.frame_count):
        faster.depth_m(frame)
        assert source.made.alive <= 3
    assert source.made.take_numbers() == list(range(12)), "in a pass each picture is read once"
    faster.depth_m(faster.frame_count - 3), faster.depth_m(faster.frame_count - 1)
    assert source.made.take_numbers() == []
    faster.depth_m(0)
    assert source.made.take_numbers() == [0]


def test_of_objects_in_pictures_eight_frames_are_kept() -> None:
    source = Pictures(20)
    objects = Segmentation(source, SegmentRule.parse("least=0.004"), 5e-4)
    source.made.take_numbers()
    for frame in range(20):
        for number in (0, 0, 1):
            objects.depth_m(frame, number)
        assert source.made.alive <= 8
    assert source.made.take_numbers() == list(range(20)), "each object of a frame is cut from one reading"
    for frame in range(12, 20):
        objects.depth_m(frame, 0)
    assert source.made.take_numbers() == []


def test_worlds_are_kept_for_sixteen_lattices(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[Grid] = []

    class World:
        def __init__(self, grid: Grid, *_: Any) -> None:
            begun.append(grid)

        def field(self, seen: int) -> int:
            return seen

        def notes(self) -> tuple[str, ...]:
            return ()

    monkeypatch.setattr(fused_scene, "_Fused", World)
    scene = FusedScene(Pictures(3))
    grids = [Grid((4, 4, 4), (0.1,) * 3, (0.0, 0.0, float(i))) for i in range(20)]
    for _ in range(2):
        for grid in grids[:16]:
            scene.field(0, grid, WALL)
    assert begun == grids[:16], "an array asks for as many slabs again and again"
    for grid in grids[16:]:
        scene.field(0, grid, WALL)
    assert len(scene._worlds) == 16
    scene.field(0, grids[19], WALL)
    assert begun == grids
    scene.field(0, grids[0], WALL)
    assert begun == [*grids, grids[0]]


@pytest.mark.parametrize("room", [0, 4, 1000])
def test_planes_of_pictures_are_kept_as_far_as_memory_allows(
    room: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fused_scene, "_MAX_PLANES_BYTES", 16 * 20 * 16 * room)
    scene = FusedScene(Pictures(10))
    made: list[int] = []
    own = scene.planes
    monkeypatch.setattr(scene, "planes", lambda frame: made.append(frame) or own(frame))
    for _ in range(2):
        for i in range(len(scene._planes.keys)):
            scene._planes[i]
    keys = [int(key) for key in scene._planes.keys]
    assert made == [*keys, *keys[room:]]


@pytest.mark.parametrize("room", [0, 3, 1000])
def test_a_segment_ends_once_its_fields_take_more_than_they_may(
    room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(segments, "MAX_SEGMENT_BYTES", room * field(0).forces_n.nbytes)
    scene = StoredScene(HapticMedium.from_frames([field(i) for i in range(16)], 50.0, AXES))
    encode(scene, tmp_path / "a.touch", EncodeSpec(nw=4, touch=TouchSpec(effort="fast", segment_frames=8)))
    with open_stream(tmp_path / "a.touch") as stream:
        counts = [segment.frame_count for segment in stream.reader.segments]
    assert sum(counts) == 16 and set(counts[:-1]) == {min(room + 1, 8)}


@pytest.mark.parametrize(("room", "waits"), [(24_000, False), (10_000_000, True)])
def test_datagrams_wait_for_a_lost_message_within_their_memory(
    room: int, waits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("raptorq", reason="datagrams need the extra broadcast")
    from touchfield.network import datagrams

    monkeypatch.setattr(datagrams, "_MAX_WAITING_BYTES", room)
    sender, gathering = datagrams.Datagrams(7), datagrams.Gathering()
    messages = [np.random.default_rng(i).bytes(4000) for i in range(12)]
    sent = [one for message in messages for one in sender.add(message)] + sender.flush()
    coming = [one for one in sent if datagrams._parse(one).number != 1]  # type: ignore[union-attr]
    out = [message for one in coming for message in gathering.receive(one)]
    if waits:
        assert out == messages[:1] and gathering.lost == 0
    else:
        assert out[-1] == messages[-1] and gathering.lost == len(messages) - len(out) > 0


def test_an_index_of_files_is_described_within_its_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from touchfield.tasks import library

    taken = []
    own = library.in_order

    def in_order(work: Any, items: Any, weight: Any, most: int, executor: Any) -> Any:
        taken.append((most, [weight(item) for item in items]))
        return own(work, items, weight, most, executor)

    monkeypatch.setattr(library, "in_order", in_order)
    scene = StoredScene(HapticMedium.from_frames([field(0)], 50.0, AXES))
    for name in ("a", "b"):
        encode(scene, tmp_path / f"{name}.touch", EncodeSpec(nw=4, touch=TouchSpec(effort="fast")))
    library.index_folder(tmp_path, tmp_path.parent / "i.npz")
    sizes = [(tmp_path / f"{name}.touch").stat().st_size for name in ("a", "b")]
    assert taken == [(library.MAX_PENDING_BYTES, sizes)]
