"""Media encoded by workers: the bytes of one process, for any worker, order and loss."""

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

pytestmark = pytest.mark.usefixtures("short_ranges")


def field(height: float, noise: float = 0.0) -> ForceField:
    """A solid below a height, in samples, with upward forces."""
    x, y, z = np.indices(GRID.shape)
    depth = np.clip(height + np.sin(x / 3) + np.cos(y / 4) - z, 0, 4)
    depth += noise * np.random.default_rng(round(1e6 * height)).standard_normal(depth.shape) * (depth > 0)
    return ForceField.from_dense(GRID, depth[..., None] * np.array([0.0, 0.1, 0.4]))


def moving(count: int = FRAMES) -> np.ndarray:
    """Newtons of frames that rise, rest, and rise again; frames at rest differ by a little."""
    heights = [5 + 0.2 * min(i, 6) + 0.2 * max(0, i - 14) for i in range(count)]
    return np.stack([field(h + 2e-4 * i).to_dense() for i, h in enumerate(heights)])


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("source") / "moving.npz"
    write_npz(path, HapticMedium.from_array(moving(), GRID))
    return path


class Shuffled(Executor):
    """Runs its tasks only when a result is requested, in reverse order; may fail on its way."""

    def __init__(self, max_tasks: int | None = None) -> None:
        self.waiting: list[tuple[Future[Any], Callable[..., Any], Any]] = []
        self.max_tasks, self.done = max_tasks, 0

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
        if self.max_tasks is not None and self.done >= self.max_tasks:
            future.set_exception(OSError("the machine is gone"))
            return
        self.done += 1
        try:
            future.set_result(pickle.loads(pickle.dumps(work(*items))))
        except BaseException as error:
            future.set_exception(pickle.loads(pickle.dumps(error)))


class Straight(Shuffled):
    """Runs the first task first."""

    def step(self) -> None:
        self.waiting.reverse()
        super().step()
        self.waiting.reverse()


def test_bytes_are_those_of_one_process_in_any_order(source: Path, alone: bytes, tmp_path: Path) -> None:
    progress: list[tuple[int, int]] = []
    for name, workers in (("shuffled", Shuffled()), ("threads", ThreadPoolExecutor(3))):
        out = tmp_path / f"{name}.touch"
        progress.clear()
        done = encode(source, out, SPEC, lambda *at: progress.append(at), executor=workers)
        assert out.read_bytes() == alone
        assert done.supported_voxels == encode(source, tmp_path / "again.touch", SPEC).supported_voxels
        assert progress[-1] == (FRAMES, FRAMES) and progress == sorted(progress)
        assert not list(tmp_path.glob("*.parts"))


def test_a_part_may_have_several_segments(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(segments, "SEGMENTS_PER_RANGE", 2)
    local = encode(source, tmp_path / "a.touch", SPEC)
    remote = encode(source, tmp_path / "b.touch", SPEC, executor=Straight())
    assert (tmp_path / "a.touch").read_bytes() == (tmp_path / "b.touch").read_bytes()
    assert local.supported_voxels == remote.supported_voxels


@pytest.mark.parametrize("count", [1, 2])
def test_processes_write_the_same_bytes(source: Path, alone: bytes, tmp_path: Path, count: int) -> None:
    with executor_of(f"processes:{count}") as workers:
        encode(source, tmp_path / "a.touch", SPEC, executor=workers)
    assert (tmp_path / "a.touch").read_bytes() == alone


def test_workers_encode_vibration_and_coder_paper_too(source: Path, tmp_path: Path) -> None:
    spec = replace(SPEC, vibration="gain=0.1,frequency=150")
    for i, requested in enumerate((spec, replace(SPEC, coder="paper", touch=TouchSpec()))):
        files = [tmp_path / f"{i}{name}.touch" for name in "ab"]
        encode(source, files[0], requested)
        encode(source, files[1], requested, executor=Shuffled())
        assert files[0].read_bytes() == files[1].read_bytes()


def test_segments_of_a_static_world_begin_with_the_same_bytes(alone: bytes) -> None:
    with TouchReader(io.BytesIO(alone)) as reader:
        bodies = [BodyReader(reader.read_segment(i), GRID, exact=False) for i in range(7)]
        firsts = [
            body.records(entry.frame_count)[0].payload
            for body, entry in zip(bodies, reader.segments, strict=True)
        ]
    assert firsts[2] == firsts[3] == firsts[4] and len(set(firsts)) == 5


def test_a_static_world_keeps_its_key_frame_across_ranges(source: Path) -> None:
    from touchfield.codec.registry import field_encoder
    from touchfield.pipeline.segments import frame_ranges

    medium = HapticMedium.from_array(moving(), GRID)
    cut = [s for s, _ in frame_ranges(medium, SPEC, field_encoder(GRID, SPEC.touch))]
    assert [s.start for s in cut] == list(range(0, FRAMES, 3))
    assert [s.key_frame for s in cut] == [0, 3, 6, 6, 6, 15, 18]  # it is static in frames 6 to 14


def test_a_run_resumes_from_finished_parts(source: Path, alone: bytes, tmp_path: Path) -> None:
    out = tmp_path / "a.touch"
    with pytest.raises(SourceError, match=r"a worker: found .*the machine is gone"):
        encode(source, out, SPEC, executor=Straight(4))
    assert len(list(Path(f"{out}.parts").iterdir())) == 4 and not out.exists()
    workers = Straight()
    result = encode(source, out, SPEC, executor=workers)
    assert workers.done == 3 and any("4 of 7 parts" in note for note in result.notes)
    assert out.read_bytes() == alone


def test_frames_without_a_force_are_noted_after_a_resumed_run(source: Path, tmp_path: Path) -> None:
    spec = replace(SPEC, touch=replace(SPEC.touch, f0_n=50.0), allow_empty=True)
    out = tmp_path / "a.touch"
    with pytest.raises(SourceError):
        encode(source, out, spec, executor=Straight(4))
    notes = encode(source, out, spec, executor=Straight()).notes
    assert any("4 of 7 parts" in note for note in notes)
    found = [
        note
        for note in encode(source, tmp_path / "b.touch", spec).notes
        if "decoded without any force" in note
    ]
    assert found and set(found) <= set(notes) and f"{FRAMES} of {FRAMES}" in found[0]


def test_damaged_and_foreign_parts_are_encoded_again(source: Path, alone: bytes, tmp_path: Path) -> None:
    out = tmp_path / "a.touch"
    with pytest.raises(SourceError):
        encode(source, out, SPEC, executor=Straight(5))
    parts = sorted(Path(f"{out}.parts").iterdir())
    data = bytearray(parts[1].read_bytes())
    data[len(data) // 2] ^= 1
    parts[1].write_bytes(data)
    parts[2].write_bytes(b"")
    parts[3].write_bytes(parts[0].read_bytes())
    workers = Straight()
    encode(source, out, SPEC, executor=workers)
    assert workers.done == 2 + 3 and out.read_bytes() == alone
    with pytest.raises(SourceError):
        encode(source, out, SPEC, executor=Straight(5))
    workers = Straight()
    encode(source, out, replace(SPEC, touch=replace(SPEC.touch, k=0.2)), executor=workers)
    assert workers.done == 7  # no part of the other job was used


@pytest.mark.parametrize("totals", [{}, {"supported": "1"}, {"supported": "1", "lost": "none"}])
def test_a_part_without_its_totals_is_encoded_again(
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


def test_a_rewritten_source_makes_another_job(tmp_path: Path) -> None:
    path = tmp_path / "depth" / "0.png"
    path.parent.mkdir()
    path.write_bytes(b"12")
    names = [workers_module.job_name(str(where), "asked") for where in (path, path.parent)]
    assert names == [workers_module.job_name(str(where), "asked") for where in (path, path.parent)]
    assert names[0] != workers_module.job_name(str(path), "asked otherwise")
    os.utime(path, (1, 1))
    later = [workers_module.job_name(str(where), "asked") for where in (path, path.parent)]
    assert len({*names, *later}) == 4


def test_a_part_damaged_before_the_join_is_named(
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


def test_invalid_sources_and_executors_are_refused(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    medium = HapticMedium.from_array(moving(4), GRID)
    with pytest.raises(InvalidArgument, match="a path, which workers can open"):
        encode(medium, tmp_path / "a.touch", SPEC, executor=Shuffled())
    task = EncodeTask("job", str(source), SPEC, segments.FrameRange(0, 3, 0), "0.0.1")
    with pytest.raises(InvalidArgument, match=r"a worker: found touchfield .*; expected 0\.0\.1"):
        encode_part(task)
    for executor in ("", "processes", "processes:0", "processes:x", "dask:", "slurm:4"):
        with pytest.raises(InvalidArgument, match="--workers"), executor_of(executor):
            pass
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(MissingExtra, match="cluster"), executor_of("dask:tcp://127.0.0.1:1"):
        pass


def test_errors_are_passed_between_processes() -> None:
    for error in (
        InvalidArgument("a", "b", "c", "d"),
        MissingExtra("x", "lib", "extra"),
        SourceError("alone"),
    ):
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is type(error) and str(again) == str(error) and again.exit_code == error.exit_code
        assert again.where == error.where


def test_plan_and_index_use_workers(source: Path, alone: bytes, tmp_path: Path) -> None:
    grid = PlanGrid(nw=(4,), k=(0.1, 0.2), step_n=(0.1,), directions=())
    local = plan(source, 1e6, EncodeSpec(nw=4), grid)
    remote = plan(source, 1e6, EncodeSpec(nw=4), grid, executor=Shuffled())
    assert local.summary() == remote.summary()
    folder = tmp_path / "media"
    folder.mkdir()
    for n in range(3):
        (folder / f"{n}.touch").write_bytes(alone[: -n or None])
    local_index, remote_index = (
        index_folder(folder),
        index_folder(folder, tmp_path / "b.npz", executor=Shuffled()),
    )
    assert len(local_index.faults) == 2 and local_index.faults == remote_index.faults
    assert local_index.path.read_bytes() == remote_index.path.read_bytes()


@contextmanager
def cluster() -> Iterator[Any]:
    """Two worker processes of dask on loopback."""
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs="ERROR"
    ) as local_cluster:
        yield local_cluster


def test_killing_three_workers_of_a_cluster_changes_no_byte(
    source: Path, alone: bytes, tmp_path: Path
) -> None:
    killed: list[int] = []
    with cluster() as local_cluster, executor_of(f"dask:{local_cluster.scheduler_address}") as workers:

        def kill(done: int, total: int) -> None:
            if done < (3, 9, 12, total + 1)[len(killed)]:
                return
            deadline = time.monotonic() + 60
            while time.monotonic() < deadline:  # until a worker is available
                alive = workers._client.run(os.getpid, on_error="return").values()
                fresh = [pid for pid in alive if isinstance(pid, int) and pid not in killed]
                if fresh:
                    killed.append(fresh[0])
                    os.kill(fresh[0], signal.SIGKILL)
                    return

        encode(source, tmp_path / "a.touch", SPEC, kill, executor=workers)
    assert len(killed) == 3
    assert (tmp_path / "a.touch").read_bytes() == alone
