"""Executors of every kind write the same bytes; a run that loses its client or its scheduler is resumed."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from child_environment import environment_with
from cluster_makers import dask_cluster, run_client
from touchfield import EncodeSpec, Grid, encode
from touchfield.codec import TouchSpec
from touchfield.compute import executor_kinds
from touchfield.compute.executor_kinds import ExecutorKind, JoblibExecutor
from touchfield.compute.executors import executor_of, in_order
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import HapticMedium
from touchfield.medium.stores.npz import write_npz
from touchfield.pipeline.tiles import encode_tiles

GRID = Grid((16, 16, 16), (0.005,) * 3, (0.0,) * 3)
SPEC = EncodeSpec(nw=4, touch=TouchSpec(segment_frames=2, effort="fast"), representation="voxel")
FRAMES = 40

pytestmark = pytest.mark.usefixtures("short_ranges")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wavy solid that rises in each frame."""
    x, y, z = np.indices(GRID.shape)
    depths = [np.clip(4 + 0.2 * i + np.sin(x / 3) + np.cos(y / 4) - z, 0, 4) for i in range(FRAMES)]
    forces_n = np.stack([depth[..., None] * np.array([0.0, 0.1, 0.4]) for depth in depths])
    path = tmp_path_factory.mktemp("source") / "rising.npz"
    write_npz(path, HapticMedium.from_array(forces_n.astype(np.float32), GRID))
    return path


class Mapping:
    """An executor with `map` alone; its results arrive together, as those of `multiprocessing.Pool`."""

    def __init__(self) -> None:
        self.sizes: list[int] = []

    def map(self, work: Callable[..., Any], items: Iterable[Any], /) -> list[Any]:
        received = pickle.loads(pickle.dumps(list(items)))
        self.sizes.append(len(received))
        return [work(item) for item in received]


def test_an_executor_with_map_alone_writes_the_same_bytes(source: Path, alone: bytes, tmp_path: Path) -> None:
    executor = Mapping()
    encode(source, tmp_path / "a.touch", SPEC, executor=executor)
    assert executor.sizes == [FRAMES // 2] and (tmp_path / "a.touch").read_bytes() == alone


def test_items_are_mapped_in_lists_of_64_and_in_order() -> None:
    executor = Mapping()
    assert list(in_order(abs, iter(range(-150, 0)), executor=executor)) == list(range(150, 0, -1))
    assert executor.sizes == [64, 64, 22] and list(in_order(abs, [], executor=executor)) == []


def test_an_error_of_the_work_is_told_from_one_of_the_executor() -> None:
    def refuses(item: int) -> int:
        raise InvalidArgument("item", str(item), "another")

    class Short(Mapping):
        def map(self, work: Callable[..., Any], items: Iterable[Any], /) -> list[Any]:
            return super().map(work, items)[:-1]

    with pytest.raises(InvalidArgument, match="item: found 3"):
        list(in_order(refuses, [3], executor=Mapping()))
    results = in_order(abs, [-1, -2], executor=Short())
    assert next(results) == 1
    with pytest.raises(SourceError, match="a worker: found that it, or its scheduler, ended"):
        next(results)


def test_an_object_that_is_no_executor_is_refused(source: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="executor: found a int; expected an object with submit or map"):
        encode(source, tmp_path / "a.touch", SPEC, executor=2)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="executor: found a int"):
        encode_tiles("sample:shapes", tmp_path / "a.zarr", SPEC, executor=2)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "text",
    [
        *("joblib:0", "joblib:two", "joblib:1025", "x:2"),
        *("ray:", "ray:0", "ray:9999", "ray:ray://127.0.0.1:99999"),
        *("dask:", "dask:host", "dask:tcp://127.0.0.1:99999", "dask:tcp://host"),
    ],
)
def test_a_wrong_text_is_refused_with_every_form(text: str) -> None:
    with (
        pytest.raises(InvalidArgument, match=r"processes:N, joblib:N, ray:N or ray:ADDRESS, dask:ADDRESS"),
        executor_of(text),
    ):
        pass


def test_a_plugin_adds_a_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Built-in kinds keep their names."""

    @contextmanager
    def opened(rest: str) -> Iterator[Mapping]:
        yield Mapping()

    kinds = {name: ExecutorKind(name, f"{name}:", lambda rest: not rest, opened) for name in ("here", "dask")}
    monkeypatch.setattr(executor_kinds, "plugins", lambda group, kind: kinds)
    executor_kinds.executor_kinds.cache_clear()
    try:
        with executor_of("here:") as executor:
            assert isinstance(executor, Mapping)
        with pytest.raises(InvalidArgument, match="here:"), executor_of("here:2"):
            pass
        assert executor_kinds.executor_kinds()["dask"] is not kinds["dask"]
    finally:
        executor_kinds.executor_kinds.cache_clear()


# -- libraries ---------------------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["joblib", "ray"])
def test_workers_of_a_library_write_the_same_bytes(
    source: Path, alone: bytes, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip(kind, reason=f"the extra {kind} is not installed")
    monkeypatch.setattr(sys.modules["__main__"], "__file__", __file__)  # ray sends it to its workers
    monkeypatch.setenv("PYTHONPATH", environment_with(Path(__file__).parent)["PYTHONPATH"])
    with executor_of(f"{kind}:2") as executor:
        assert executor is not None and os.getpid() not in set(
            in_order(worker_pid, range(8), executor=executor)
        )
        encode(source, tmp_path / "a.touch", SPEC, executor=executor)
        with pytest.raises(InvalidArgument, match="a worker: found touchfield") as caught:
            list(in_order(fail, [1], executor=executor))
        with pytest.raises(SourceError, match="a worker: found that it, or its scheduler, ended"):
            list(in_order(kill_worker, [1], executor=executor))
    assert "\n" not in str(caught.value)
    assert (tmp_path / "a.touch").read_bytes() == alone


def test_an_address_of_ray_without_a_listener_is_refused() -> None:
    pytest.importorskip("ray", reason="the extra ray is not installed")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with (
        pytest.raises(SourceError, match=r"found that ray does not start or answer \(Connection refused\)"),
        executor_of(f"ray:ray://127.0.0.1:{port}"),
    ):
        pass


def worker_pid(item: int) -> int:
    return os.getpid()


def fail(item: int) -> None:
    raise InvalidArgument("a worker", "touchfield 0", "1")


def kill_worker(item: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.thorough
def test_a_backend_of_joblib_and_a_pool_write_the_same_bytes(
    source: Path, alone: bytes, tmp_path: Path
) -> None:
    joblib = pytest.importorskip("joblib", reason="the extra joblib is not installed")
    encode(
        source, tmp_path / "a.touch", SPEC, executor=JoblibExecutor(joblib.Parallel(2, backend="threading"))
    )
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        encode(source, tmp_path / "b.touch", SPEC, executor=PoolOfMap(pool))
    assert (tmp_path / "a.touch").read_bytes() == (tmp_path / "b.touch").read_bytes() == alone


class PoolOfMap:
    """`map` of a pool, without its `apply` and `imap`."""

    def __init__(self, pool: Any) -> None:
        self.map = pool.map


# -- killed ------------------------------------------------------------------------------------------------


def require_resumed(folder: Path, source: Path, workers: str, alone: bytes) -> None:
    """Run the client again: it continues from at least three parts, and leaves nothing but the file."""
    parts = len(list((folder / "a.touch.parts").glob("0*.touch")))
    assert parts >= 3 and not (folder / "a.touch").exists()
    done = run_client(folder, source, workers, -1)
    assert f"{parts} of {FRAMES // 2} parts were there from an earlier run" in done.stdout, done.stderr
    assert (folder / "a.touch").read_bytes() == alone
    assert sorted(path.name for path in folder.glob("*a.touch*")) == ["a.touch"]


def processes_named(text: str) -> list[int]:
    """The processes whose command line has a text."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if text.encode() in file.read_bytes():
                found.append(int(file.parent.name))
        except OSError:  # it has ended
            continue
    return found


@pytest.mark.thorough
@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="needs /proc to find processes")
def test_workers_end_with_a_killed_client_and_the_run_is_resumed(
    source: Path, alone: bytes, tmp_path: Path
) -> None:
    tagged = tmp_path / "client.py"  # workers of `spawn` have it in the command of their parent only
    assert run_client(tmp_path, source, "processes:2", 0).returncode == -signal.SIGKILL
    deadline = time.monotonic() + 30
    while processes_named(str(tagged)) and time.monotonic() < deadline:
        time.sleep(0.05)
    require_resumed(tmp_path, source, "processes:2", alone)


@pytest.mark.thorough
@pytest.mark.parametrize("victim", ["scheduler", "client"])
def test_a_run_of_a_cluster_is_resumed_after_its_client_or_scheduler_is_killed(
    source: Path, alone: bytes, tmp_path: Path, victim: str
) -> None:
    pytest.importorskip("distributed", reason="the extra cluster is not installed")
    with dask_cluster(tmp_path / "first") as (address, scheduler):
        killed = run_client(tmp_path, source, f"dask:{address}", scheduler if victim == "scheduler" else 0)
        if victim == "client":
            assert killed.returncode == -signal.SIGKILL
            require_resumed(tmp_path, source, f"dask:{address}", alone)
            return
    assert killed.returncode == 1 and "a worker: found that it, or its scheduler, ended" in killed.stderr
    assert "Traceback" not in killed.stderr and "goes on from what is finished" in killed.stderr
    with dask_cluster(tmp_path / "second") as (address, _):
        require_resumed(tmp_path, source, f"dask:{address}", alone)
