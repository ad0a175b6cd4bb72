"""Clusters that lose a process: a client that kills itself or another, and dask with a worker."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from child_environment import environment_with

CLIENT = """
import os, signal, sys
from touchfield import EncodeSpec, encode
from touchfield.codec import TouchSpec
from touchfield.compute.executors import executor_of
from touchfield.errors import TouchfieldError
from touchfield.pipeline import segments

def report(done, total):
    if done == 6 and victim >= 0:
        os.kill(victim or os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    segments.SEGMENTS_PER_RANGE = 1
    source, out, workers, victim = *sys.argv[1:4], int(sys.argv[4])
    spec = EncodeSpec(nw=4, touch=TouchSpec(segment_frames=2, effort="fast"), representation="voxel")
    try:
        with executor_of(workers) as executor:
            print(*encode(source, out, spec, report, executor=executor).notes)
    except TouchfieldError as error:
        sys.exit(str(error))
"""
"""Encodes SOURCE as OUT by WORKERS; kills process VICTIM (0: itself, -1: none) after the third part."""


def run_client(folder: Path, source: Path, workers: str, victim: int) -> subprocess.CompletedProcess[str]:
    """Run `CLIENT` in `folder`; its output is OUT."""
    script = folder / "client.py"
    script.write_text(CLIENT)
    command = [sys.executable, script, source, folder / "a.touch", workers, str(victim)]
    return subprocess.run(
        [str(part) for part in command],
        env=environment_with(folder),
        capture_output=True,
        text=True,
        timeout=120,
    )


@contextmanager
def dask_cluster(folder: Path) -> Iterator[tuple[str, int]]:
    """A scheduler and a worker of dask; its address, and the process of the scheduler."""
    folder.mkdir()
    file = folder / "scheduler.json"
    scheduler = (
        "scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
        "--scheduler-file",
        file,
    )
    worker = ("worker", "--nthreads", "1", "--no-dashboard", "--no-nanny", "--scheduler-file", file)
    commands = (scheduler, (*worker, "--local-directory", folder))
    with ExitStack() as started:
        processes = []
        for command in commands:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *map(str, command)],
                env=environment_with(folder),
                stderr=subprocess.DEVNULL,
            )
            started.callback(process.wait)
            started.callback(process.kill)
            processes.append(process)
        deadline = time.monotonic() + 60
        while not file.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.1)  # until it is written
        yield json.loads(file.read_text())["address"], processes[0].pid
