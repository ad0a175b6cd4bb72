"""Compares bytes and error of coder `touch` with coder `paper` and general-purpose coders.

    python bench/rate.py [--quick] [--nw 5 6 7] [--fields NAME ...] [--efforts NAME ...] [--only WHAT ...]
                         [--keep FOLDER] [--stored-peers]

The fields are those of `rate_fields`. There are two comparisons, each of one frame and of five frames in one
segment:

* NMSE: bytes at the NMSE of coder `paper` (n_q 6, 258 directions, no deadband).
* promise: bytes within the error bound |e| <= max(F_0, k |F|) with k = 0.1 and F_0 = 0.05 N. Every peer keeps
  the bound, too.

The peers are the coders of `rate_peers`, and for depth sequences the coded depth maps (`rate_source`). A peer
that is not installed is named and left out. Then follow the speed of each effort on two cores, and the bytes
of falling bodies as objects. The bars compare with the former figures of ``reference/rate_before.json``; the
range of the best peer's bytes over those of `touch` is printed.

The speed is measured first, alone, and in every run; the other figures use one process per core. `--keep`
keeps the other figures in a folder. A run that was interrupted, or is repeated after a change of some source,
measures only what is missing there. `--stored-peers` takes the figures of the peers, which take most of the
time, from the stored result wherever all bytes and errors of `touch` and `paper` of a row are equal to the
stored ones, and so its field is; the peers of other rows are measured. `--quick` takes one frame of one field
at n_w 5. A full run writes ``results/rate.json`` and ``results/rate.png``.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import provenance
import rate_ours as ours
import rate_peers as peers
from machine import (
    RESULTS,
    SHARED,
    Bar,
    Figures,
    at_least,
    at_most,
    check_quick,
    keep,
    show,
    stale,
    stored,
    table,
    text,
)
from rate_fields import FRAMES, WALL_VOXELS, Case, cases
from rate_pool import Job, Pool, cached, fields_in, fingerprint
from rate_symbols import F0_N, K
from touchfield.codec.touch.spec import EFFORTS

SIDES = (5, 6, 7)
SECTIONS = ("NMSE", "promise", "five", "speed", "objects", "picture")
PICTURE_NW = 6
DEFAULT = "default"
MEAN, P_OVER_I = 1.0, 1.0
"""Limits relative to the former figures.

MEAN is for the mean bytes of the fields, P_OVER_I for later frames over single frames.
"""
SPEEDS = {
    ("tum band", DEFAULT, "decode"): 60,
    ("tum band", DEFAULT, "encode"): 12,
    ("icl band", DEFAULT, "decode"): 30,
    ("icl band", DEFAULT, "encode"): 8,
    ("tum band", "fast", "encode"): 40,
    ("icl band", "fast", "encode"): 20,
}
"""Minimum frames per second at 128^3 samples on two cores."""
SAME_DB = 0.1
"""Largest difference of NMSE at which bytes are compared with the former ones."""
TITLES = {
    ("NMSE", 1): "1. One frame at the NMSE of coder paper: bytes",
    ("promise", 1): f"2. One frame, |e| <= max({F0_N:g} N, {K:g} |F|): bytes; the peers keep it too",
    ("NMSE", 5): "3. Five frames in a segment at the NMSE of coder paper: bytes of all",
    ("promise", 5): "4. Five frames in a segment at the promise: bytes of all",
}
BEFORE = json.loads((Path(__file__).parent / "reference" / "rate_before.json").read_text())


def best(sizes: Figures) -> tuple[str, float]:
    """Return name and size of the smallest finite size."""
    finite = [(size, name) for name, size in sizes.items() if math.isfinite(size)]
    size, name = min(finite, default=(math.nan, "-"))
    return name, size


def mean(ratios: Sequence[float]) -> float | None:
    """Return the geometric mean; None for an empty list."""
    return math.exp(sum(map(math.log, ratios)) / len(ratios)) if ratios else None


def former_of(before: Figures, row: Figures) -> Any:
    """Return the former figure of the same field; None if there is none."""
    return before.get(row["field"])


@dataclass
class Report:
    """All figures of a run.

    A row of `sizes` has "field", "kind", "at" ("NMSE" or "promise"), "frames", "nmse_db", "touch" by effort
    (bytes), "p_over_i" by effort, "peers", and what else its jobs returned. A row of `speeds` has "field",
    "effort" and the figures of `rate_ours.speed`. `before` has the former figures, with which the bars
    compare. `stored_peers` is the number of rows whose peers are those of the stored result.
    """

    efforts: tuple[str, ...]
    before: Figures
    sizes: list[Figures] = field(default_factory=list)
    speeds: list[Figures] = field(default_factory=list)
    objects: dict[str, float] = field(default_factory=dict)
    curves: dict[str, Figures] = field(default_factory=dict)
    stored_peers: int = 0

    def at(self, at: str, frames: int) -> list[Figures]:
        """Return the rows of a table."""
        return [row for row in self.sizes if row["at"] == at and (row["frames"] > 1) is (frames > 1)]

    def tables(self) -> Iterator[str]:
        """Yield the tables with at least one row."""
        peer_columns = ("best peer", "bytes", "over default", "coded source", "on paper's symbols")
        head = ("field", "NMSE dB", "paper", *self.efforts, "P over I", "beyond", "worst", *peer_columns)
        for (at, frames), title in TITLES.items():
            if rows := [self._cells(row) for row in self.at(at, frames)]:
                yield table(title, head, rows)

    def _cells(self, row: Figures) -> tuple[str, ...]:
        name, size = best(row["peers"])
        touch, (on, on_size) = row["touch"], best(row.get("on_paper", {}))
        return (
            row["field"], text(row["nmse_db"]), text(row.get("paper")),
            *(text(touch.get(e)) for e in self.efforts), text(row["p_over_i"].get(DEFAULT)),
            text(row.get("beyond")), text(row.get("worst")),
            name, text(size), text(size / touch.get(DEFAULT, math.nan)),
            text(row["peers"].get("coded source")), f"{text(on_size)} {on}",
        )  # fmt: skip

    def _ratios(
        self, at: str, frames: int, over: Callable[[Figures], Any], under: Callable[[Figures], Any]
    ) -> list[float]:
        pairs = [(over(row), under(row)) for row in self.at(at, frames)]
        return [a / b for a, b in pairs if a and b and math.isfinite(a / b)]

    def _former(self, row: Figures) -> float | None:
        """Return the former bytes of the same field, if measured at the same error."""
        old = self.before[row["at"]].get(row["field"], {})
        return (
            old.get(DEFAULT) if abs(old.get("nmse_db", row["nmse_db"]) - row["nmse_db"]) < SAME_DB else None
        )

    def bytes(self) -> Figures:
        """Return the bytes of every effort for each field."""
        return {
            f"{row['field']}, {row['at']}, {row['frames']} frames": {
                f"{effort}_bytes": n for effort, n in row["touch"].items()
            }
            for row in self.sizes
        }

    def ranges(self) -> dict[str, list[float]]:
        """Return the range over all fields of the best peer's bytes over those of `touch`."""
        found = {}
        for at, frames in TITLES:
            over = self._ratios(at, frames, lambda r: best(r["peers"])[1], lambda r: r["touch"].get(DEFAULT))
            if over:
                found[f"{DEFAULT}, {at}, {frames} frame{'s' * (frames > 1)}"] = [min(over), max(over)]
        return found

    def bars(self) -> list[Bar]:
        """Return bars for the former figures, the best peer, and frames per second."""
        verdicts: list[Bar] = []
        for at in ("promise", "NMSE"):
            over = self._ratios(at, 1, lambda r: r["touch"].get(DEFAULT), self._former)
            label = f"{at}, one frame: bytes of {DEFAULT} over the former {DEFAULT}, {len(over)} fields"
            verdicts.append(at_most(f"{label}, mean", mean(over), MEAN))
            former = partial(former_of, self.before[f"p_over_i, {at}"])
            over = self._ratios(at, 5, lambda r: r["p_over_i"].get(DEFAULT), former)
            label = f"{at}, five frames: P over I of {DEFAULT} over the former, {len(over)} fields, mean"
            verdicts.append(at_most(label, mean(over), P_OVER_I))
        beyond = [row["beyond"] for row in self.sizes if row["at"] == "promise"]
        verdicts.append(at_most("voxels beyond the mask, all efforts", sum(beyond) if beyond else None, 0))
        for name, (minimum, _) in self.ranges().items():
            verdicts.append(at_least(f"bytes of the best peer over ours: {name}", minimum, 1.0))
        speeds = {(row["field"], row["effort"]): row for row in self.speeds}
        for (name, effort, direction), minimum in SPEEDS.items():
            row = speeds.get((f"{name}, nw 7", effort), {})
            label, measured = (
                f"{name}, 128^3, two cores: {effort} {direction}s",
                row.get(f"{direction}_frames_s"),
            )
            verdicts.append(at_least(label, measured, minimum, "frames/s"))
        return verdicts


def jobs_of(case: Case, at: str, count: int, efforts: Sequence[str]) -> list[Job]:
    """Return the jobs of a row: coder `touch` at each effort, and the peers.

    Five frames are coded at the default effort only, once with inter-frame prediction and once without.
    """
    jobs = [Job(case, "by_peers", count, {"at": at})]
    for effort in efforts:
        if count == 1 or effort == DEFAULT:
            for interframe in ("auto", "off")[:count]:
                jobs.append(Job(case, "by_us", count, {"at": at, "effort": effort, "interframe": interframe}))
    return jobs


def row_of(case: Case, at: str, count: int, pool: Pool, efforts: Sequence[str]) -> dict[str, Any]:
    """Collect the row of these jobs."""
    row: dict[str, Any] = {"field": case.title, "kind": case.kind, "at": at, "frames": count, "peers": {}}
    row |= {"touch": {}, "all_i": {}, "p_over_i": {}, "nmse_db": float("nan"), "beyond": 0, "worst": 0.0}
    for job in jobs_of(case, at, count, efforts):
        found, effort = pool.found.get(job.name, {}), job.args.get("effort")
        if not found or job.part == "by_peers":
            row |= found
            continue
        row["touch" if job.args["interframe"] == "auto" else "all_i"][effort] = found["touch"]
        row["beyond"] += found.get("beyond", 0)
        row["worst"] = max(row["worst"], found.get("worst", 0.0))
        row |= {name: found[name] for name in ("nmse_db", "paper", "voxels") if name in found}
        if job.args["interframe"] == "auto":
            later = found["later_bits"]
        elif found["later_bits"]:
            row["p_over_i"][effort] = later / found["later_bits"]
    return row


def measure_speeds(report: Report, pool: Pool, selected: Sequence[Case]) -> None:
    """Measure each effort alone on the machine.

    The kernels are compiled before, on a small field.
    """
    for effort in report.efforts:
        pool.log(f"compiling {effort}")
        ours.touch(selected[0].frames(fields_in(pool.folder))[:2], effort=effort)
    for case in selected:
        if case.nw == 7 and case.kind in ("band", "height"):
            frames = case.frames(fields_in(pool.folder))
            for effort in report.efforts:
                report.speeds.append({"field": case.title, "effort": effort, **ours.speed(frames, effort)})
                pool.log(f"{report.speeds[-1]}")


def drawn_cases(selected: Sequence[Case], folder: Path) -> list[Case]:
    """Return the band and the height field with the most voxels, to be drawn.

    Of the fields at n_w 6 or, if there are none, at the largest n_w.
    """
    side = min((case.nw for case in selected), key=lambda nw: (nw != PICTURE_NW, -nw))
    drawable = [case for case in selected if case.nw == side and case.kind in ("band", "height")]
    drawable.sort(key=lambda case: case.frames(fields_in(folder))[0].support_count)
    return list({case.kind: case for case in drawable}.values())


def arguments() -> Any:
    """Parse the options."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one frame of one field at n_w 5")
    parser.add_argument("--nw", type=int, nargs="+", default=list(SIDES))
    parser.add_argument("--fields", nargs="+", help="names such as 'tum band'")
    parser.add_argument("--efforts", nargs="+", default=list(EFFORTS), choices=EFFORTS)
    parser.add_argument("--only", nargs="+", default=list(SECTIONS), choices=SECTIONS, help="some of it")
    parser.add_argument("--keep", type=Path, help="a folder of figures, to go on from")
    parser.add_argument("--stored-peers", action="store_true", help="peers of fields that are as they were")
    options = parser.parse_args()
    is_all = (tuple(options.nw), options.efforts, tuple(options.only)) == (SIDES, list(EFFORTS), SECTIONS)
    options.is_full = is_all and not options.quick and not options.fields
    if options.quick:
        options.nw, options.fields = [5], ["tum band", "motorcycle band"]
        options.only = [section for section in options.only if section in ("NMSE", "promise")]
    return options


Row = tuple[Case, str, int]


def without_peers(jobs: Sequence[Job]) -> list[Job]:
    """Return the jobs that code with `touch` and `paper`."""
    return [job for job in jobs if not job.part.endswith("peers")]


def commit_of_peers() -> str:
    """Return the commit at which the peers of the stored result were measured."""
    before = stored("rate")
    measured_in: Figures = before.get("peers_of") or before["run"]
    return str(measured_in["commit"])


def is_as_stored(figures: Figures, before: Figures) -> bool:
    """Return whether figures, of which there are some, are equal to the stored ones."""
    return bool(figures) and figures == {key: before.get(key) for key in figures}


def take_stored_peers(pool: Pool, rows: Sequence[Row], drawn: Sequence[Case], efforts: Sequence[str]) -> int:
    """Code all fields, and take the peers' figures of those that are as they were; return their number.

    SystemExit if the sources of the peers have changed since.
    """
    if changed := [file for file in stale("rate") if file.startswith("bench/rate_")]:
        sys.exit(f"--stored-peers: {', '.join(changed)} changed since: run without it")
    jobs = [Job(case, "curve") for case in drawn]
    jobs += [job for row in rows for job in without_peers(jobs_of(*row, efforts))]
    pool.run(jobs)
    before = stored("rate")
    sizes = {(row["field"], row["at"], row["frames"]): row for row in before["sizes"]}
    taken = 0
    for case, at, count in rows:
        row, old = row_of(case, at, count, pool, efforts), sizes.get((case.title, at, count), {})
        if is_as_stored({key: value for key, value in row.items() if key != "peers"}, old):
            job = jobs_of(case, at, count, efforts)[0]
            pool.found[job.name] = {key: old[key] for key in ("peers", "on_paper", "source") if key in old}
            taken += 1
    for case in drawn:
        curves, old = pool.found.get(Job(case, "curve").name, {}), before["curves"].get(case.title, {})
        if is_as_stored(curves, old):
            of_peers = {key: value for key, value in old.items() if key not in curves}
            pool.found[Job(case, "curve_peers").name] = of_peers
            taken += 1
    pool.log(f"peers of {taken} of {len(rows) + len(drawn)} rows are those of {commit_of_peers()}")
    return taken


def measured(options: Any, pool: Pool, selected: list[Case]) -> Report:
    """Run all requested sections."""
    report = Report(tuple(options.efforts), BEFORE)
    if "speed" in options.only:
        measure_speeds(report, pool, selected)
    if "objects" in options.only:
        key = ["objects", max(options.nw), fingerprint("ours"), fingerprint("fields")]
        report.objects = cached(pool.folder, key, lambda: ours.object_bytes(max(options.nw)))
    drawn = drawn_cases(selected, pool.folder) if "picture" in options.only else []
    curves = [Job(case, part) for case in drawn for part in ("curve", "curve_peers")]
    counts = (1, FRAMES) if "five" in options.only else (1,)
    rows = [
        (case, at, count)
        for at in ("NMSE", "promise")
        if at in options.only
        for count in counts
        for case in selected
    ]
    if options.stored_peers:
        report.stored_peers = take_stored_peers(pool, rows, drawn, options.efforts)
    jobs = [*curves, *(job for row in rows for job in jobs_of(*row, options.efforts))]
    pool.run([job for job in jobs if job.name not in pool.found])
    report.sizes = [row_of(*row, pool, options.efforts) for row in rows]
    for job in curves:
        report.curves.setdefault(job.case.title, {}).update(pool.found.get(job.name, {}))
    return report


def bars(figures: dict[str, Any]) -> list[Bar]:
    """Return the bars of the report of these figures."""
    return Report(EFFORTS, BEFORE, figures["sizes"], figures["speeds"]).bars()


def main() -> None:
    """Print tables and bars, store the figures, and draw the picture."""
    options, trace, run = arguments(), provenance.Trace(), provenance.Run()
    os.environ["TOUCHFIELD_THREADS"] = "1"  # each core works on a segment or process of its own
    selected = list(cases(tuple(options.nw), options.fields and tuple(options.fields)))
    where = "TUM desk and ICL living room" if SHARED.is_dir() else "the samples (../shared/data is not there)"
    with tempfile.TemporaryDirectory(prefix="touchfield-rate-") as scratch:
        pool = Pool(options.keep or Path(scratch))
        pool.log(
            f"fields: {where}; a band's wall is {WALL_VOXELS} voxels of the mean spacing; Phantom Omni, 500 "
            "N/m"
        )
        report = measured(options, pool, selected)
    for lines in report.tables():
        print(lines)
    if report.curves:
        from rate_picture import draw

        draw(report.curves, {row["field"]: row for row in report.at("promise", 1)}, RESULTS / "rate.png")
    figures = {"fields": where, "wall_voxels": WALL_VOXELS, "k": K, "f0_n": F0_N, "absent": peers.absent()}
    if report.stored_peers:
        figures["peers_of"] = {"commit": commit_of_peers(), "rows": report.stored_peers}
    figures |= {"best_peer_over_ours": report.ranges(), "speeds": report.speeds, "objects": report.objects}
    show(figures | {"failed": pool.failed})
    figures |= {"sizes": report.sizes, "curves": report.curves, "failed": pool.failed}
    code = provenance.code_of(trace.files())
    keep("rate", figures, report.bars(), not options.is_full, run.summary(), code)
    if options.quick:
        check_quick("rate", report.bytes())
    sys.exit(bool(pool.failed))


if __name__ == "__main__":
    main()
