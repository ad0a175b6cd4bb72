"""Size against error: coder `touch` beside coder `paper` and general-purpose coders, everything counted.

    python bench/rate.py [--quick] [--nw 5 6 7] [--fields NAME ...] [--efforts NAME ...] [--only WHAT ...]
                         [--picture FILE] [--keep FOLDER] [--data FOLDER]

Two comparisons of one frame, and of five in one segment: the bytes at the NMSE of coder `paper` (n_q 6, 258
directions, no deadband), and the bytes under the promise |e| <= max(F_0, k |F|), k = 0.1 and F_0 = 0.05 N, which
every peer keeps too; among the peers is the source itself, coded (`rate_source`). Then the speed of each effort on
two cores, and falling bodies as objects. At the end the bars, against the figures of ``results/rate_before.json``,
and the range of the best peer over ours. `--quick` takes one field at n_w 6. A peer that is not installed is
named and left out. The speed is measured first, alone, and anew in every run; then every core has a process. With
`--keep` the other figures are kept in a folder, and a run that was interrupted, or is repeated after a change of some
source, measures only what is not there. A full run also writes ``results/rate.json`` and ``results/rate.png``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rate_ours as ours
import rate_peers as peers
from machine import RESULTS, SHARED, Bar, keep, show
from rate_fields import FRAMES, WALL_VOXELS, Case, cases
from rate_pool import Job, Pool, fields_in, fingerprint, kept
from rate_report import DEFAULT, Report
from rate_symbols import F0_N, K

SIDES = (5, 6, 7)
WHAT = ("NMSE", "promise", "five", "speed", "objects", "picture")
PICTURE_NW = 6
BEFORE = json.loads((RESULTS / "rate_before.json").read_text())


def jobs_of(case: Case, at: str, count: int, efforts: Sequence[str]) -> list[Job]:
    """Coder `touch` and the peers; of five frames the default and the strongest effort, and each frame alone, too."""
    made = [Job(case, "by_peers", count, {"at": at})]
    for effort in efforts:
        if count == 1 or effort in (DEFAULT, ours.STRONGEST):
            for interframe in ("auto", "off")[:count]:
                made.append(Job(case, "by_us", count, {"at": at, "effort": effort, "interframe": interframe}))
    return made


def row_of(case: Case, at: str, count: int, pool: Pool, efforts: Sequence[str]) -> dict[str, Any]:
    """The row of those jobs."""
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


def measure_speeds(report: Report, pool: Pool, chosen: Sequence[Case]) -> None:
    """Each effort, with the machine to itself, after the first, small field was coded once to compile all."""
    for effort in report.efforts:
        pool.say(f"compiling {effort}")
        ours.touch(chosen[0].frames(fields_in(pool.folder))[:2], effort=effort)
    for case in chosen:
        if case.nw == 7 and case.kind in ("band", "height"):
            frames = case.frames(fields_in(pool.folder))
            for effort in report.efforts:
                report.speeds.append({"field": case.title, "effort": effort, **ours.speed(frames, effort)})
                pool.say(f"{report.speeds[-1]}")


def drawn_cases(chosen: Sequence[Case], folder: Path) -> list[Case]:
    """A band and a height field at n_w 6, or at the largest n_w that there is: those of the most voxels."""
    side = min((case.nw for case in chosen), key=lambda nw: (nw != PICTURE_NW, -nw))
    asked = [case for case in chosen if case.nw == side and case.kind in ("band", "height")]
    asked.sort(key=lambda case: case.frames(fields_in(folder))[0].support_count)
    return list({case.kind: case for case in asked}.values())


def arguments() -> Any:
    """What was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one field at n_w 6, no speed and no objects")
    parser.add_argument("--nw", type=int, nargs="+", default=list(SIDES))
    parser.add_argument("--fields", nargs="+", help="names such as 'tum band'")
    parser.add_argument("--efforts", nargs="+", default=list(ours.EFFORTS), choices=ours.EFFORTS)
    parser.add_argument("--only", nargs="+", default=list(WHAT), choices=WHAT, help="some of it")
    parser.add_argument("--picture", type=Path, default=RESULTS / "rate.png", help="where to draw")
    parser.add_argument("--keep", type=Path, help="a folder of figures, to go on from")
    parser.add_argument("--data", type=Path, default=SHARED, help="the optional real inputs: ../shared/data")
    asked = parser.parse_args()
    is_all = (tuple(asked.nw), asked.efforts, tuple(asked.only)) == (SIDES, list(ours.EFFORTS), WHAT)
    asked.is_full = is_all and not asked.quick and not asked.fields
    if asked.quick:
        asked.nw, asked.fields = [6], ["tum band", "motorcycle band"]
        asked.only = [what for what in asked.only if what not in ("speed", "objects", "picture")]
    return asked


def measured(asked: Any, pool: Pool, chosen: list[Case]) -> Report:
    """Everything that was asked for."""
    report = Report(tuple(asked.efforts), BEFORE)
    if "speed" in asked.only:
        measure_speeds(report, pool, chosen)
    if "objects" in asked.only:
        key = ["objects", max(asked.nw), fingerprint("ours"), fingerprint("fields")]
        report.objects = kept(pool.folder, key, lambda: ours.object_bytes(max(asked.nw)))
    drawn = drawn_cases(chosen, pool.folder) if "picture" in asked.only else []
    curves = [Job(case, part) for case in drawn for part in ("curve", "curve_peers")]
    counts = (1, FRAMES) if "five" in asked.only else (1,)
    rows = [
        (case, at, count) for at in ("NMSE", "promise") if at in asked.only for count in counts for case in chosen
    ]  # fmt: skip
    pool.run([*curves, *(job for row in rows for job in jobs_of(*row, asked.efforts))])
    report.sizes = [row_of(*row, pool, asked.efforts) for row in rows]
    for job in curves:
        report.curves.setdefault(job.case.title, {}).update(pool.found.get(job.name, {}))
    return report


def bars(figures: dict[str, Any]) -> list[Bar]:
    """Those of the report of these figures."""
    return Report(ours.EFFORTS, BEFORE, figures["sizes"], figures["speeds"]).bars()


def main() -> None:
    """Print the tables and the bars, keep the figures, draw the picture."""
    asked, began = arguments(), time.perf_counter()
    os.environ["TOUCHFIELD_THREADS"] = "1"  # a core has a segment, or a process, of its own
    chosen = list(cases(tuple(asked.nw), asked.fields and tuple(asked.fields), asked.data))
    where = "TUM desk and ICL living room" if asked.data.is_dir() else "the samples (../shared/data is not there)"
    with tempfile.TemporaryDirectory(prefix="touchfield-rate-") as scratch:
        pool = Pool(asked.keep or Path(scratch))
        pool.say(f"fields: {where}; a band's wall is {WALL_VOXELS} voxels of the mean spacing; Phantom Omni, 500 N/m")
        report = measured(asked, pool, chosen)
    for one in report.tables():
        print(one)
    if report.curves:
        from rate_picture import draw

        draw(report.curves, {row["field"]: row for row in report.at("promise", 1)}, asked.picture)
    figures = {"fields": where, "wall_voxels": WALL_VOXELS, "k": K, "f0_n": F0_N, "absent": peers.absent()}
    figures |= {"best_peer_over_ours": report.ranges(), "speeds": report.speeds, "objects": report.objects}
    show(figures | {"failed": pool.failed})
    figures |= {"sizes": report.sizes, "curves": report.curves, "failed": pool.failed}
    keep("rate", {**figures, "seconds": time.perf_counter() - began}, report.bars(), not asked.is_full)
    sys.exit(bool(pool.failed))


if __name__ == "__main__":
    main()
