"""The parts of `rate.py`: a process for each core, the longest first, what was kept, and the time that is left."""

from __future__ import annotations

import multiprocessing
import os
import sys
import traceback
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from types import TracebackType
from typing import Any

import rate_peers as peers
from rate_fields import Case, digest
from rate_keep import Keep, fingerprint
from rate_parts import PARTS, WORK, Figures
from touchfield.medium.npz import read_npz
from touchfield.parallel import worker_count


@dataclass(frozen=True)
class Job:
    """A part for a field. Of the parts that do not involve our coder the figures depend on the peers alone."""

    case: Case
    part: str
    args: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What it is found under."""
        # the step of five frames follows from that of one, and tells nothing apart
        told = [self.args["interframe"]] if "interframe" in self.args else []
        step = [f"{self.args['step_n']:g}"] if self.part.startswith("curve") and "step_n" in self.args else []
        return " ".join([self.part, *told, *step])


def _alone() -> None:
    os.environ["TOUCHFIELD_THREADS"] = "1"  # a core has a process of its own


def _made(case: Case, folder: Path) -> tuple[str, int, int]:
    frames = case.frames(folder)
    return digest(frames), frames[0].support_count, len(frames)


def _worked(part: str, path: Path, args: dict[str, Any]) -> tuple[Figures, float]:
    began = perf_counter()
    return PARTS[part](list(read_npz(path)), **args), perf_counter() - began


class Pool:
    """Processes, and all that they have found: ``found[case.title, job.name]``, None of what failed."""

    def __init__(self, keep: Keep) -> None:
        self.keep, self.workers = keep, worker_count()
        self.found: dict[tuple[str, str], Figures | None] = {}
        self.digests: dict[str, tuple[str, int, int]] = {}
        self.failed: list[str] = []
        self._done_s = self._done_work = 0.0
        self._began = perf_counter()
        self._pool = ProcessPoolExecutor(self.workers, multiprocessing.get_context("spawn"), initializer=_alone)

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        self._pool.shutdown(wait=kind is None, cancel_futures=True)

    def say(self, text: str) -> None:
        """On the standard error, with the seconds so far."""
        print(f"[{perf_counter() - self._began:.0f} s] {text}", file=sys.stderr, flush=True)

    def prepare(self, cases: list[Case]) -> None:
        """Make all fields."""
        made = self._pool.map(_made, cases, [self.keep.fields] * len(cases))
        self.digests = dict(zip((case.title for case in cases), made, strict=True))

    def count(self, case: Case) -> int:
        """Its frames."""
        return self.digests[case.title][2]

    def voxels(self, case: Case) -> int:
        """With a force, in its first frame."""
        return self.digests[case.title][1]

    def run(self, jobs: list[Job], then: Callable[[Job, Figures], list[Job]] = lambda *_: []) -> None:
        """All jobs, and those that `then` names when one is done; the longest that waits is next."""
        waiting, running = list(jobs), dict[Future[tuple[Figures, float]], Job]()
        while waiting or running:
            waiting.sort(key=self._work)
            while waiting and len(running) < self.workers:
                job = waiting.pop()
                known = self.keep.get(f"{job.case.title}-{job.name}", self._key(job))
                if known is not None:
                    self.found[job.case.title, job.name] = known
                    waiting += then(job, known)
                    waiting.sort(key=self._work)
                    continue
                running[self._pool.submit(_worked, job.part, job.case.path(self.keep.fields), job.args)] = job
            for future in wait(running, return_when=FIRST_COMPLETED).done if running else ():
                job = running.pop(future)
                figures = self._taken(job, future)
                waiting += then(job, figures) if figures is not None else []
                left = sum(map(self._work, (*waiting, *running.values()))) / self.workers
                rate = self._done_s / self._done_work if self._done_work else 1.0
                self.say(f"{job.case.title}: {job.name} done; about {max(0.0, left * rate):.0f} s left")

    def _taken(self, job: Job, future: Future[tuple[Figures, float]]) -> Figures | None:
        figures = None
        try:
            figures, seconds = future.result()
        except Exception:  # one part that fails leaves a gap in its table, and is told at the end
            self.failed.append(f"{job.case.title}: {job.name}")
            traceback.print_exc()
        else:
            self._done_s, self._done_work = self._done_s + seconds, self._done_work + self._work(job)
            self.keep.put(f"{job.case.title}-{job.name}", self._key(job), {**figures, "seconds": seconds})
        self.found[job.case.title, job.name] = figures
        return figures

    def _work(self, job: Job) -> float:
        return 1e-3 * WORK[job.part] * self.voxels(job.case)

    def _key(self, job: Job) -> list[Any]:
        by_peers = job.part.endswith("_peers") or job.part == "curve_paper"
        source = [fingerprint("peers"), *peers.absent()] if by_peers else [fingerprint("ours")]
        return [self.digests[job.case.title][0], job.part, job.args, source]
