"""Media coded by workers: the bytes of one process, whoever works, in any order, after any loss."""

from __future__ import annotations

import io
import os
import pickle
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield import EncodeSpec, Grid, encode
from touchfield.codec import TouchSpec
from touchfield.codec.touch.body import BodyReader
from touchfield.compute.executors import executor_of
from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import CorruptFile, InvalidArgument, MissingExtra, SourceError, TouchfieldError
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.stores.npz import write_npz
from touchfield.pipeline import segments, workers as workers_module
from touchfield.pipeline.segments import EncodedSegment
from touchfield.pipeline.workers import EncodeTask, encode_part
from touchfield.tasks.library import index_folder
from touchfield.tasks.plan import PlanGrid, plan

GRID = Grid((16, 16, 16), (0.005,) * 3, (0.0,) * 3)
SPEC = EncodeSpec(nw=4, touch=TouchSpec(segment_frames=3, effort="fast"), representation="voxel")
FRAMES = 20


def field(height: float, noise: float = 0.0) -> ForceField:
    """A solid below a height, in samples, its forces upwards."""
    x, y, z = np.indices(GRID.shape)
    depth = np.clip(height + np.sin(x / 3) + np.cos(y / 4) - z, 0, 4)
    depth += noise * np.random.default_rng(round(1e6 * height)).standard_normal(depth.shape) * (depth > 0)
    return ForceField.from_dense(GRID, depth[..., None] * np.array([0.0, 0.1, 0.4]))


def moving(count: int = FRAMES) -> np.ndarray:
    """Newtons of frames that rise, stand, and rise again; those that stand differ by a little."""
    heights = [5 + 0.2 * min(i, 6) + 0.2 * max(0, i - 14) for i in range(count)]
    return np.stack([field(h + 2e-4 * i).to_dense() for i, h in enumerate(heights)])


@pytest.fixture(scope="module", autouse=True)
def short_stretches() -> Iterator[None]:
    """Stretches of one segment, so that there are many."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(segments, "SEGMENTS_PER_RANGE", 1)
        yield


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("source") / "moving.npz"
    write_npz(path, HapticMedium.from_array(moving(), GRID))
    return path


@pytest.fixture(scope="module")
def alone(source: Path) -> bytes:
    """The bytes of one process."""
    out = source.with_name("alone.touch")
    encode(source, out, SPEC)
    return out.read_bytes()


class Shuffled(Executor):
    """Runs what it was given only when a result is waited for, the last first; may break down on its way."""

    def __init__(self, most: int | None = None) -> None:
        self.waiting: list[tuple[Future[Any], Callable[..., Any], Any]] = []
        self.most, self.done = most, 0

    def submit(self, work: Callable[..., Any], *items: Any, **_: Any) -> Future[Any]:
        outer, travelled = self, pickle.loads(pickle.dumps((work, items)))

        class Late(Future[Any]):
            def result(self, timeout: float | None = None) -> Any:
                while not self.done():
                    outer.step()
                return super().result(timeout)

        future: Future[Any] = Late()
        self.waiting.append((future, *travelled))
        return future

    def step(self) -> None:
        future, work, items = self.waiting.pop()
        if self.most is not None and self.done >= self.most:
            future.set_exception(OSError("the machine is gone"))
            return
        self.done += 1
        try:
            future.set_result(pickle.loads(pickle.dumps(work(*items))))
        except BaseException as error:
            future.set_exception(pickle.loads(pickle.dumps(error)))


class Straight(Shuffled):
    """The first is done first."""

    def step(self) -> None:
        self.waiting.reverse()
        super().step()
        self.waiting.reverse()


def test_bytes_are_those_of_one_process_in_any_order(source: Path, alone: bytes, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    for name, workers in (("shuffled", Shuffled()), ("threads", ThreadPoolExecutor(3))):
        out = tmp_path / f"{name}.touch"
        told.clear()
        done = encode(source, out, SPEC, lambda *at: told.append(at), executor=workers)
        assert out.read_bytes() == alone
        assert done.supported_voxels == encode(source, tmp_path / "again.touch", SPEC).supported_voxels
        assert told[-1] == (FRAMES, FRAMES) and told == sorted(told)
        assert not list(tmp_path.glob("*.parts"))


def test_a_part_may_have_several_segments(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(segments, "SEGMENTS_PER_RANGE", 2)
    here = encode(source, tmp_path / "a.touch", SPEC)
    there = encode(source, tmp_path / "b.touch", SPEC, executor=Straight())
    assert (tmp_path / "a.touch").read_bytes() == (tmp_path / "b.touch").read_bytes()
    assert here.supported_voxels == there.supported_voxels


@pytest.mark.parametrize("count", [1, 2])
def test_processes_write_the_same_bytes(source: Path, alone: bytes, tmp_path: Path, count: int) -> None:
    with executor_of(f"processes:{count}") as workers:
        encode(source, tmp_path / "a.touch", SPEC, executor=workers)
    assert (tmp_path / "a.touch").read_bytes() == alone


def test_vibrating_media_and_the_paper_s_coder_travel_too(source: Path, tmp_path: Path) -> None:
    spec = replace(SPEC, vibration="gain=0.1,frequency=150")
    for i, asked in enumerate((spec, replace(SPEC, coder="paper", touch=TouchSpec()))):
        files = [tmp_path / f"{i}{name}.touch" for name in "ab"]
        encode(source, files[0], asked)
        encode(source, files[1], asked, executor=Shuffled())
        assert files[0].read_bytes() == files[1].read_bytes()


def test_segments_of_a_world_that_stands_begin_with_the_same_bytes(alone: bytes) -> None:
    with TouchReader(io.BytesIO(alone)) as reader:
        bodies = [BodyReader(reader.read_segment(i), GRID, exact=False) for i in range(7)]
        firsts = [
            body.records(one.frame_count)[0].payload
            for body, one in zip(bodies, reader.segments, strict=True)
        ]
    assert firsts[2] == firsts[3] == firsts[4] and len(set(firsts)) == 5


def test_a_world_that_stands_keeps_its_anchor_from_stretch_to_stretch(source: Path) -> None:
    from touchfield.codec.registry import field_encoder
    from touchfield.pipeline.segments import frame_ranges

    medium = HapticMedium.from_array(moving(), GRID)
    cut = [s for s, _ in frame_ranges(medium, SPEC, field_encoder(GRID, SPEC.touch))]
    assert [s.start for s in cut] == list(range(0, FRAMES, 3))
    assert [s.key_frame for s in cut] == [0, 3, 6, 6, 6, 15, 18]  # it stands in frames 6 to 14


def test_a_run_goes_on_from_what_was_finished(source: Path, alone: bytes, tmp_path: Path) -> None:
    out = tmp_path / "a.touch"
    with pytest.raises(SourceError, match=r"a worker: found .*the machine is gone"):
        encode(source, out, SPEC, executor=Straight(4))
    assert len(list(Path(f"{out}.parts").iterdir())) == 4 and not out.exists()
    workers = Straight()
    result = encode(source, out, SPEC, executor=workers)
    assert workers.done == 3 and any("4 of 7 parts" in note for note in result.notes)
    assert out.read_bytes() == alone


def test_frames_without_a_force_are_told_of_where_parts_were_there(source: Path, tmp_path: Path) -> None:
    asked, out = replace(SPEC, touch=replace(SPEC.touch, f0_n=50.0)), tmp_path / "a.touch"
    with pytest.raises(SourceError):
        encode(source, out, asked, executor=Straight(4))
    notes = encode(source, out, asked, executor=Straight()).notes
    assert any("4 of 7 parts" in note for note in notes)
    told = [
        note
        for note in encode(source, tmp_path / "b.touch", asked).notes
        if "decoded without any force" in note
    ]
    assert told and set(told) <= set(notes) and f"{FRAMES} of {FRAMES}" in told[0]


def test_parts_that_are_damaged_or_of_another_job_are_made_again(
    source: Path, alone: bytes, tmp_path: Path
) -> None:
    out = tmp_path / "a.touch"
    with pytest.raises(SourceError):
        encode(source, out, SPEC, executor=Straight(5))
    kept = sorted(Path(f"{out}.parts").iterdir())
    data = bytearray(kept[1].read_bytes())
    data[len(data) // 2] ^= 1
    kept[1].write_bytes(data)
    kept[2].write_bytes(b"")
    kept[3].write_bytes(kept[0].read_bytes())
    workers = Straight()
    encode(source, out, SPEC, executor=workers)
    assert workers.done == 2 + 3 and out.read_bytes() == alone
    with pytest.raises(SourceError):
        encode(source, out, SPEC, executor=Straight(5))
    workers = Straight()
    encode(source, out, replace(SPEC, touch=replace(SPEC.touch, k=0.2)), executor=workers)
    assert workers.done == 7  # nothing of the other job was taken


@pytest.mark.parametrize("totals", [{}, {"supported": "1"}, {"supported": "1", "lost": "none"}])
def test_a_part_without_its_totals_is_made_again(
    source: Path, alone: bytes, tmp_path: Path, totals: dict[str, str]
) -> None:
    out = tmp_path / "a.touch"
    with pytest.raises(SourceError):
        encode(source, out, SPEC, executor=Straight(4))
    part = min(Path(f"{out}.parts").iterdir())
    with TouchReader(part) as reader:
        head, provenance = reader.head, {**reader.provenance}
        coded = [
            EncodedSegment(reader.read_segment(i), reader.read_vibration(i), entry.frame_count)
            for i, entry in enumerate(reader.segments)
        ]
    del provenance["supported"], provenance["lost"]
    with TouchWriter(part) as writer:
        writer.write_head(head, {**provenance, **totals})
        for _ in segments.write_segments(writer, coded):
            pass
    folder = workers_module._PartFolder(part.parent, replace(head, frame_count=FRAMES), provenance["job"])
    first = segments.FrameRange(0, head.frame_count, 0)
    with pytest.raises(CorruptFile, match=r"0000000000\.touch: found supported .*; expected whole numbers"):
        next(folder.read(first))
    assert not folder.has(first)
    workers = Straight()
    encode(source, out, SPEC, executor=workers)
    assert workers.done == 1 + 3 and out.read_bytes() == alone


def test_a_job_is_another_where_its_source_was_written_again(tmp_path: Path) -> None:
    path = tmp_path / "depth" / "0.png"
    path.parent.mkdir()
    path.write_bytes(b"12")
    names = [workers_module.job_name(str(where), "asked") for where in (path, path.parent)]
    assert names == [workers_module.job_name(str(where), "asked") for where in (path, path.parent)]
    assert names[0] != workers_module.job_name(str(path), "asked otherwise")
    os.utime(path, (1, 1))
    later = [workers_module.job_name(str(where), "asked") for where in (path, path.parent)]
    assert len({*names, *later}) == 4


def test_a_part_that_is_damaged_before_the_join_is_named(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = workers_module._PartFolder.write

    def damaged(self: Any, stretch: Any, part: Any) -> None:
        write(self, stretch, part)
        path = self.part(stretch)[0]
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)

    monkeypatch.setattr(workers_module._PartFolder, "write", damaged)
    with pytest.raises(TouchfieldError, match="parts"):
        encode(source, tmp_path / "a.touch", SPEC, executor=Shuffled())
    assert not (tmp_path / "a.touch").exists()


def test_what_cannot_be_is_said(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    medium = HapticMedium.from_array(moving(4), GRID)
    with pytest.raises(InvalidArgument, match="a path, which workers can open"):
        encode(medium, tmp_path / "a.touch", SPEC, executor=Shuffled())
    task = EncodeTask("job", str(source), SPEC, segments.FrameRange(0, 3, 0), "0.0.1")
    with pytest.raises(InvalidArgument, match=r"a worker: found touchfield .*; expected 0\.0\.1"):
        encode_part(task)
    for words in ("", "processes", "processes:0", "processes:x", "dask:", "slurm:4"):
        with pytest.raises(InvalidArgument, match="--workers"), executor_of(words):
            pass
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(MissingExtra, match="cluster"), executor_of("dask:tcp://127.0.0.1:1"):
        pass


def test_errors_travel_between_processes() -> None:
    for error in (
        InvalidArgument("a", "b", "c", "d"),
        MissingExtra("x", "lib", "extra"),
        SourceError("alone"),
    ):
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is type(error) and str(again) == str(error) and again.exit_code == error.exit_code
        assert again.where == error.where


def test_plan_and_index_ask_workers(source: Path, alone: bytes, tmp_path: Path) -> None:
    grid = PlanGrid(nw=(4,), k=(0.1, 0.2), step_n=(0.1,), directions=())
    here = plan(source, 1e6, EncodeSpec(nw=4), grid)
    there = plan(source, 1e6, EncodeSpec(nw=4), grid, executor=Shuffled())
    assert here.summary() == there.summary()
    folder = tmp_path / "media"
    folder.mkdir()
    for n in range(3):
        (folder / f"{n}.touch").write_bytes(alone[: -n or None])
    mine, theirs = index_folder(folder), index_folder(folder, tmp_path / "b.npz", executor=Shuffled())
    assert len(mine.faults) == 2 and mine.faults == theirs.faults
    assert mine.path.read_bytes() == theirs.path.read_bytes()


@contextmanager
def cluster() -> Iterator[Any]:
    """Two worker processes of dask on loopback."""
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs="ERROR"
    ) as made:
        yield made


def test_a_worker_of_a_cluster_that_is_killed_three_times_changes_no_byte(
    source: Path, alone: bytes, tmp_path: Path
) -> None:
    killed: list[int] = []
    with cluster() as made, executor_of(f"dask:{made.scheduler_address}") as workers:

        def kill(done: int, total: int) -> None:
            if done < (3, 9, 12, total + 1)[len(killed)]:
                return
            deadline = time.monotonic() + 60
            while time.monotonic() < deadline:  # until one is there again
                alive = workers._client.run(os.getpid, on_error="return").values()
                fresh = [pid for pid in alive if isinstance(pid, int) and pid not in killed]
                if fresh:
                    killed.append(fresh[0])
                    os.kill(fresh[0], signal.SIGKILL)
                    return

        encode(source, tmp_path / "a.touch", SPEC, kill, executor=workers)
    assert len(killed) == 3
    assert (tmp_path / "a.touch").read_bytes() == alone
