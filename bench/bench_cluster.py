"""Measures work by several processes: speed-up, memory of a worker, lost processes, and object stores.

    python bench/bench_cluster.py [--quick]

spread: falling bodies as voxels, 2000 frames at 1 kHz, with one worker and with two. Each worker has one
thread, and kernels are compiled before the timed run. Efficiency is that of the wall clock; where other
programs use the cores, the processor seconds of the workers say more.

tiles: a real stereo picture on the nominal lattice of the Phantom Omni (2909 x 2182 x 1273 samples) as a zarr
store of tiles, with two workers. The memory is that of the largest process.

memory: the scan of a toy as a store at n_w 9 and 10, and as a file at n_w 8 and 9, with two workers; the
largest resident memory of a worker, and of the process that started it.

executors: a depth sequence of a moving camera by each kind of `--workers`; the bytes are compared with those
of one process. killed: the same by dask and processes, where the client or the scheduler is killed after the
third part, and the same call is made again.

objects: a file and a store of 256^3 samples in a bucket on loopback; the requests that read one segment of
the file, and a box of 8^3 samples of the store.

A quick run takes 512 frames, 2^8 samples along each axis for tiles, and n_w 6 and 7. What needs a library or
the optional folder of real inputs is not measured without it.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from cluster_makers import dask_cluster, run_client
from machine import SHARED, Bar, Figures, at_least, at_most, bench, column, figure, need_module
from peak_memory import peak_bytes
from s3_makers import bucket_server
from touchfield import EncodeSpec, device, encode
from touchfield.codec import TouchSpec
from touchfield.compute.executor_kinds import TaskExecutor
from touchfield.compute.executors import executor_of
from touchfield.container import TouchReader
from touchfield.pipeline.tiles import encode_tiles

SOURCE = "sample:falling-7"
TILED = "sample:motorcycle"
SCAN = SHARED / "meshes" / "parasaurolophus_scan" / "parasaurolophus_6700.ply"
SEQUENCE = SHARED / "rgbd_tum_fr1_rpy"
SMALL = EncodeSpec(nw=6, representation="voxel", touch=TouchSpec(effort="fast"))


def seconds(out: Path, spec: EncodeSpec, workers: TaskExecutor | None) -> float:
    """Return the wall seconds of one encoding."""
    began = perf_counter()
    encode(SOURCE, out, spec, executor=workers)
    return perf_counter() - began


def children_s() -> float | None:
    """Return the processor seconds of the worker processes so far; None without /proc."""
    ticks = 0
    for child in multiprocessing.active_children():
        status = Path(f"/proc/{child.pid}/stat")
        if not status.exists():
            return None
        fields = status.read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])  # user and system
    return ticks / os.sysconf("SC_CLK_TCK")


def children_mb() -> list[float]:
    """Return the largest resident memory of each worker process so far; empty without /proc.

    The system's figure of ended processes also counts what their parent had when they were started.
    """
    statuses = [Path(f"/proc/{child.pid}/status") for child in multiprocessing.active_children()]
    texts = [status.read_text() for status in statuses if status.exists()]
    found = [re.search(r"VmHWM:\s*(\d+) kB", text) for text in texts]
    return [1024 * int(match[1]) / 1e6 for match in found if match]


def spread(frames: int, rounds: int) -> Figures:
    """Encode without workers, with one and with two; return times and efficiency."""
    spec = EncodeSpec(nw=6, representation="voxel", frames=(0, frames))
    figures: Figures = {"frames": frames}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "a.touch"
        seconds(out, spec, None)
        alone = out.read_bytes()
        figures["bytes"] = len(alone)
        same = True
        for count in (1, 2) * rounds:
            with executor_of(f"processes:{count}") as workers:
                seconds(out, replace(spec, frames=(0, 256 * count)), workers)
                before = children_s()
                took = seconds(out, spec, workers)
                after = children_s()
            if before is not None and after is not None:
                cpu = f"workers_{count}_processor_s"
                figures[cpu] = min(after - before, figures.get(cpu, after - before))
            figures[f"workers_{count}_s"] = min(took, figures.get(f"workers_{count}_s", took))
            same &= out.read_bytes() == alone
        figures["same_bytes"] = same
    figures["efficiency"] = figures["workers_1_s"] / (2 * figures["workers_2_s"])
    if "workers_1_processor_s" in figures:
        figures["processor_efficiency"] = figures["workers_1_processor_s"] / figures["workers_2_processor_s"]
    return figures


def huge(nw: int | None) -> Figures:
    """Encode a workspace in tiles; return sizes and times.

    `nw` is the n_w of the lattice; None takes the nominal lattice of the device.
    """
    spec = EncodeSpec(nw=nw, touch=TouchSpec(effort="fast"))
    with tempfile.TemporaryDirectory() as folder, executor_of("processes:2") as workers:
        done = encode_tiles(TILED, Path(folder) / "a.zarr", spec, executor=workers)
        processes_mb = [*children_mb(), peak_bytes() / 1e6]
    samples = done.prepared.medium.grid.voxel_count
    return {
        "most_bytes": 1e6 * max(processes_mb),
        "samples": samples,
        "tiles": done.tiles,
        "supported_voxels": done.supported_voxels,
        "file_bytes": done.file_bytes,
        "seconds": done.encode_s,
        "core_seconds_a_tile": 2 * done.encode_s / done.tiles,
        "samples_a_second_and_core": samples / done.encode_s / 2,
    }


def large(nw: int, ending: str) -> Figures:
    """Encode the scan with two workers; return sizes, and the memory of a worker and of the client."""
    spec = EncodeSpec(nw=nw, touch=TouchSpec(effort="fast"))
    with tempfile.TemporaryDirectory() as folder, executor_of("processes:2") as workers:
        out = Path(folder) / f"a{ending}"
        write = encode_tiles if ending == ".zarr" else encode
        done = write(SCAN, out, spec, executor=workers)
        workers_mb = children_mb()
    return {
        "supported_voxels": done.supported_voxels,
        "file_bytes": done.file_bytes,
        "seconds": done.encode_s,
        "worker_mb": max(workers_mb, default=None),
        "client_mb": peak_bytes() / 1e6,
    }


def in_a_process(call: str, *arguments: object) -> Figures:
    """Run a function of this file in a separate process, so that only its memory counts."""
    run = "getattr(bench_cluster, sys.argv[1])(*json.loads(sys.argv[2]))"
    code = f"import json, sys, bench_cluster; print(json.dumps({run}))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", code, call, json.dumps(arguments)],
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return dict(json.loads(done.stdout))


def memory(low_nw: int) -> Figures:
    """Encode the scan as a store at two resolutions, and as a file at half of these.

    A file is encoded a frame at a time, and its memory follows the samples with a force.
    """
    if not SCAN.is_file():
        return {}
    cases = [(low_nw - 1, ".touch"), (low_nw, ".touch"), (low_nw, ".zarr"), (low_nw + 1, ".zarr")]
    return {f"{ending}, n_w {nw}": in_a_process("large", nw, ending) for nw, ending in cases}


def growth(figures: Figures, ending: str) -> float | None:
    """Return the memory of a worker at the higher n_w over that at the lower."""
    megabytes = column(
        {k: v for k, v in figures.get("memory", {}).items() if k.startswith(ending)}, "worker_mb"
    )
    return megabytes[1] / megabytes[0] if megabytes else None


def executors() -> Figures:
    """Encode the depth sequence by each kind of executors that is installed."""
    if not SEQUENCE.is_dir():
        return {}
    rows: Figures = {}
    with tempfile.TemporaryDirectory() as name:
        out, encoded = Path(name) / "a.touch", []
        with ExitStack() as stack:
            kinds = {"one process": None, "processes": "processes:2"}
            kinds |= {kind: f"{kind}:2" for kind in ("joblib", "ray") if find_spec(kind)}
            if find_spec("distributed"):
                kinds["dask"] = f"dask:{stack.enter_context(dask_cluster(Path(name) / 'dask'))[0]}"
            for kind, text in kinds.items():
                with executor_of(text) as executor:
                    began = perf_counter()
                    encode(SEQUENCE, out, SMALL, executor=executor)
                encoded.append(out.read_bytes())
                is_same = encoded[-1] == encoded[0]
                rows[kind] = {"bytes": len(encoded[-1]), "same": is_same, "wall_s": perf_counter() - began}
    return rows


def killed() -> Figures:
    """Kill the client or the scheduler after the third part of the sequence, and run the same call again."""
    if not (SEQUENCE.is_dir() and Path("/proc").is_dir()):
        return {}
    rows = {"client of processes": lost("processes:2", is_scheduler=False)}
    if find_spec("distributed"):
        rows |= {
            f"{victim} of dask": lost("dask", victim == "scheduler") for victim in ("client", "scheduler")
        }
    return rows


def lost(workers: str, is_scheduler: bool) -> Figures:
    """Kill a process in the middle of an encoding; return what was left, and what the second run did."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder, whole, text, scheduler = Path(name), Path(name) / "whole", workers, 0
        whole.mkdir()
        run_client(whole, SEQUENCE, "processes:1", -1)
        if workers == "dask":
            address, scheduler = stack.enter_context(dask_cluster(folder / "first"))
            text = f"dask:{address}"
        first = run_client(folder, SEQUENCE, text, scheduler if is_scheduler else 0)
        parts = len(list((folder / "a.touch.parts").glob("0*.touch")))
        is_partial = (folder / "a.touch").exists()
        if is_scheduler:
            text = f"dask:{stack.enter_context(dask_cluster(folder / 'second'))[0]}"
        second = run_client(folder, SEQUENCE, text, -1)
        resumed = re.search(r"(\d+) of (\d+) parts were there", second.stdout)
        left = [path.name for path in folder.glob("*a.touch*") if path.name != "a.touch"]
        return {
            "exit": first.returncode,
            "left": parts,
            "reused": int(resumed[1]) if resumed else 0,
            "of": int(resumed[2]) if resumed else 0,
            "same": (folder / "a.touch").read_bytes() == (whole / "a.touch").read_bytes(),
            "clean": not left and not is_partial,
        }


def objects() -> Figures:
    """Write a file and a store to a bucket; return the requests of writing, and of reading a part."""
    if not (find_spec("moto") and find_spec("obstore")):
        return {}
    parts = replace(SMALL, frames=(0, 256), touch=TouchSpec(effort="fast", segment_frames=32))
    with bucket_server() as (requests, environment):
        os.environ.update(environment)
        done = encode(SOURCE, "s3://bucket/a.touch", parts)
        puts = len(requests.lines)
        requests.lines.clear()
        with TouchReader("s3://bucket/a.touch") as reader:
            reader.read_segment(len(reader.segments) // 2)
            received = reader._source.remote.received if reader._source.remote else 0
        file = {"bytes": done.file_bytes, "puts": puts, "ranges": requests.of("GET", "", 206)}
        file |= {"whole": requests.of("GET", "", 200), "received_bytes": received}
        requests.lines.clear()
        tiled = encode_tiles(TILED, "s3://bucket/a.zarr", replace(SMALL, nw=8))
        store: Figures = {"bytes": tiled.file_bytes, "puts": requests.of("PUT", "", 200)}
        array = import_module("zarr").open_array(
            _object_store("s3://bucket/a.zarr"), path="forces_n", mode="r"
        )
        middle = [slice(n // 2, n // 2 + 8) for n in array.shape[1:4]]
        requests.lines.clear()
        array[(0, *middle)]
        store |= {
            "ranges": requests.of("GET", "forces_n/c", 206),
            "whole": requests.of("GET", "forces_n/c", 200),
        }
    return {"file, a segment": file, "store, a box of 8^3": store}


def _object_store(url: str) -> Any:
    """The store of an address, for plain zarr."""
    return import_module("zarr").storage.ObjectStore(
        import_module("obstore.store").from_url(url), read_only=True
    )


def measure(frames: int, is_huge: int, rounds: int, low_nw: int) -> Figures:
    """Measure each part; see the text above."""
    need_module("zarr")
    os.environ["TOUCHFIELD_THREADS"] = "1"
    tiles = in_a_process("huge", None if is_huge else 8)
    return {
        "nominal": list(device("phantom-omni").lattice),
        "tiles": tiles,
        "spread": spread(frames, rounds),
        "memory": memory(low_nw),
        "executors": executors(),
        "killed": killed(),
        "objects": objects(),
    }


def bars(figures: Figures) -> list[Bar]:
    """Limit memory and requests; require efficiency, equal bytes and resumption."""
    killed = [*figures.get("killed", {}).values()]
    same = [
        figures["spread"]["same_bytes"],
        *column([*figures.get("executors", {}).values(), *killed], "same"),
    ]
    resumed = [row["reused"] == row["left"] >= 3 and row["clean"] for row in killed]
    whole = column(figures.get("objects", []), "whole")
    return [
        at_least("efficiency of two processes", figure(figures, "spread", "efficiency"), 0.85),
        at_least(
            "efficiency of two processes, processor seconds",
            figure(figures, "spread", "processor_efficiency"),
            0.85,
        ),
        at_least("same bytes with every executor, and after a kill", float(all(same)), 1.0),
        at_least("killed runs resumed, nothing left", float(all(resumed)) if resumed else None, 1.0),
        at_least("samples of the workspace", figure(figures, "tiles", "samples"), 8e9),
        at_most("memory of the largest process", figure(figures, "tiles", "most_bytes"), 2e9, "bytes"),
        at_most(
            "memory of a worker, the largest of all",
            max(column(figures.get("memory", []), "worker_mb"), default=None),
            2000,
            "MB",
        ),
        at_most("growth of a worker's memory, a file", growth(figures, ".touch"), 4.0),
        at_most("growth of a worker's memory, a store", growth(figures, ".zarr"), 1.5),
        at_most("objects read as a whole for a part", float(sum(whole)) if whole else None, 0.0),
    ]


if __name__ == "__main__":
    bench("cluster", __doc__, measure, bars, frames=(2000, 512), is_huge=(1, 0), rounds=(2, 1), low_nw=(9, 6))
