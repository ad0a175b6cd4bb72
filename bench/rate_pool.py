"""Runs the measurements of `rate.py` in parallel, one for each field and part, and caches their figures.

The key of a cached figure contains what it depends on: the frames, the options, and the source of the coder.
After a change of the package's coders only these are measured again, not the peers. Speeds are never cached.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import sys
import traceback
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cache
from itertools import repeat
from pathlib import Path
from time import perf_counter
from typing import Any

import rate_ours as ours
import rate_peers as peers
import rate_symbols as lattices
import touchfield
from rate_fields import Case, Volume
from rate_source import coded_source
from touchfield.medium import ForceField
from touchfield.medium.stores.npz import read_npz

Figures = dict[str, Any]
PACKAGE, BENCH = Path(touchfield.__file__).parent, Path(__file__).parent
STEPS_N = (0.4, 0.24, 0.14, 0.08, 0.045, 0.025)
"""Steps of the curves, newtons."""
TOLERANCES = {"zfp": 8.0, "SZ3": 0.6, "SPERR": 0.7}
"""Tolerance of each lossy coder over the step, so that all have similar errors."""
PAPER = ((3, "ico3"), (4, "ico3"), (4, "octa3"), (6, "octa3"), (8, "ico10"), (8, "ico20"))
"""n_q and directions of the points of a curve, from coarse to fine."""


def by_us(case: Case, frames: list[ForceField], at: str, effort: str, interframe: str) -> Figures:
    """Code frames in a segment with coder `touch`.

    `at` is "promise", the error bound, or "NMSE", the NMSE of coder `paper`.
    """
    if at == "NMSE":
        paper = ours.paper(frames, interframe="none")
        search = ours.touch_search(frames, paper.nmse_db, effort, interframe)
        context = {"nmse_db": paper.nmse_db, "paper": paper.bytes}
        return {"touch": search.size(), "later_bits": search.size(1), **context}
    coded = ours.touch(frames, effort=effort, interframe=interframe)
    context = {"nmse_db": coded.nmse_db, "beyond": coded.beyond, "worst": coded.worst}
    return {
        "touch": coded.bytes,
        "later_bits": coded.later_bits,
        "voxels": frames[0].support_count,
        **context,
    }


def by_peers(case: Case, frames: list[ForceField], at: str) -> Figures:
    """Code the same frames with all peers; code coder `paper`'s symbols, too."""
    volume, target_db = Volume.of(frames), None
    if at == "NMSE":
        target_db = ours.paper(frames, interframe="none").nmse_db
        found = {"peers": peers.at_error(volume, target_db), "on_paper": peers.on_paper(frames)}
    else:
        found = {"peers": peers.at_promise(volume)}
    if case.has_maps and peers.module("JPEG XL"):
        found["source"] = coded_source(case, frames, target_db)
        found["peers"]["coded source"] = found["source"]["bytes"]
    return found


def curve(case: Case, frames: list[ForceField]) -> Figures:
    """Return points (NMSE in dB, bytes) of one frame by coders `touch` and `paper`."""
    touch = [ours.touch(frames, mode="nmse", step_n=step) for step in STEPS_N]
    paper = [ours.paper(frames, nq=nq, directions=directions) for nq, directions in PAPER]
    return {
        name: [[result.nmse_db, result.bytes] for result in results]
        for name, results in (("touch", touch), ("paper", paper))
    }


def curve_peers(case: Case, frames: list[ForceField]) -> Figures:
    """Return the points of every peer."""
    volume, points = Volume.of(frames), dict[str, list[list[float]]]()
    for step in STEPS_N:
        quantised = lattices.uniform(volume.forces_n, step)
        error = volume.nmse_db(quantised.decoded)
        for name, size in peers.lossless(quantised.symbols).items():
            points.setdefault(name, []).append([error, size])
        for name, code in peers.lossy().items():
            size, decoded = code(volume.forces_n, TOLERANCES[name] * step)
            points.setdefault(name, []).append([volume.nmse_db(decoded), size])
    return points


PARTS: dict[str, Callable[..., Figures]] = {
    part.__name__: part for part in (by_us, by_peers, curve, curve_peers)
}


@cache
def fingerprint(group: str) -> str:
    """Return a hash of the source of "fields", "peers" or "ours"."""
    codec = PACKAGE / "codec"
    if group == "fields":  # all that may change the field, and no coder
        paths = [p for p in PACKAGE.rglob("*.py") if codec not in p.parents] + [BENCH / "rate_fields.py"]
    elif group == "peers":  # with coder paper, whose error they are measured at
        paths = [p for p in codec.rglob("*.py") if "paper" in str(p.relative_to(codec))]
        paths += [p for p in BENCH.glob("rate_*.py") if p.stem != "rate_picture"]
    else:
        paths = [*codec.rglob("*.py"), BENCH / "rate_ours.py", BENCH / "rate_pool.py"]
    return hashlib.sha256(b"".join(p.read_bytes() for p in sorted(paths))).hexdigest()[:12]


def fields_in(folder: Path) -> Path:
    """Return the folder of the frames for this state of the source."""
    return folder / f"fields-{fingerprint('fields')}"


def cached(folder: Path, key: Any, make: Callable[[], Figures]) -> Figures:
    """Return the figures of an earlier run, or those of `make`, written atomically."""
    path = folder / f"{hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:24]}.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        new = path.with_suffix(".new")
        new.write_text(json.dumps(make(), default=float))
        new.replace(path)
    found: Figures = json.loads(path.read_text())
    return found


@dataclass(frozen=True)
class Job:
    """One part of the benchmark on the first frames of a field."""

    case: Case
    part: str
    count: int = 1
    args: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Key of the job in `Pool.found`."""
        return " ".join([self.case.title + ":", self.part, str(self.count), *map(str, self.args.values())])

    def work(self, folder: Path) -> Figures:
        """Run the job in a worker process, with caching."""
        path, source = self.case.path(fields_in(folder)), "peers" if self.part.endswith("peers") else "ours"
        key = [
            hashlib.sha256(path.read_bytes()).hexdigest(),
            self.name,
            fingerprint(source),
            source == "peers" and peers.absent(),
        ]
        return cached(
            folder, key, lambda: PARTS[self.part](self.case, list(read_npz(path))[: self.count], **self.args)
        )


class Pool:
    """Figures of all jobs: ``found[job.name]``; failed jobs are absent."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.found, self.failed = folder, dict[str, Figures](), list[str]()
        self._began = perf_counter()

    def log(self, text: str) -> None:
        """Print to standard error, with the elapsed seconds."""
        print(f"[{perf_counter() - self._began:.0f} s] {text}", file=sys.stderr, flush=True)

    def run(self, jobs: list[Job]) -> None:
        """Run all jobs, the largest first.

        A failed job is missing in its table and listed in `failed`.
        """
        with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
            for _ in pool.map(
                Case.path, dict.fromkeys(job.case for job in jobs), repeat(fields_in(self.folder))
            ):
                pass  # make all fields first
            ordered = sorted(jobs, key=lambda job: (job.case.nw, job.count), reverse=True)
            waiting = {pool.submit(job.work, self.folder): job for job in ordered}
            for n, future in enumerate(as_completed(waiting), 1):
                name = waiting[future].name
                try:
                    self.found[name] = future.result()
                except Exception:
                    self.failed.append(name)
                    traceback.print_exc()
                self.log(f"{name} done, {n} of {len(waiting)}")
