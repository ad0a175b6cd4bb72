"""Size against error: coder `touch` beside coder `paper` and general-purpose coders, everything counted.

    python bench/rate.py [--quick] [--nw 5 6 7] [--fields NAME ...] [--efforts fast default max] [--picture FILE]
                         [--keep FOLDER] [--data FOLDER]

Three comparisons, each with its bar: the bytes of one frame at the NMSE of coder `paper` (n_q 6, 258 directions, no
deadband); the bytes of one frame under the promise |e| <= max(F_0, k |F|), k = 0.1 and F_0 = 0.05 N, which every peer
keeps too; and both for five frames in one segment. Then the speed of each effort, and falling bodies as objects.
`--quick` takes one field at n_w 6. A peer that is not installed is named and left out. The speed is measured first,
alone; then every core has a process. With `--keep` all figures are kept in a folder, and a run that was interrupted,
or is repeated after a change of some source, measures only what is not there. The table goes to the standard output,
progress to the standard error; a full run also writes ``results/rate.json`` and ``results/rate.png``.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import rate_ours as ours
import rate_peers as peers
from machine import RESULTS, keep
from rate_fields import SHARED, WALL_VOXELS, Case, cases, falling_objects
from rate_keep import Keep, fingerprint
from rate_parts import STEPS_N, Figures
from rate_pool import Job, Pool
from rate_report import Report

SIDES = (5, 6, 7)
EFFORTS = ("fast", "default", "max")
PICTURE_NW = 6
ONCE_NW = 7
"""From here on five frames take one trial at the step of the first frame, if it is near enough."""


def jobs_of(case: Case, efforts: Sequence[str], count: int) -> list[Job]:
    """All that can be measured of a field at once; `after` has the rest."""
    listed = {"efforts": list(efforts)}
    made = [Job(case, "equal", listed), Job(case, "promise", listed)]
    made += [Job(case, "equal_peers"), Job(case, "promise_peers")]
    if count > 1:
        made += [Job(case, "five_promise", {"effort": efforts[-1], "interframe": i}) for i in ("auto", "off")]
        made += [Job(case, "five_equal_peers"), Job(case, "five_promise_peers")]
    return made


def after(job: Job, figures: Figures, efforts: Sequence[str], count: int) -> list[Job]:
    """Five frames at the NMSE of coder paper, when the step of one is known."""
    if job.part != "equal" or count < 2:
        return []
    once = job.case.nw >= ONCE_NW
    asked = {"effort": efforts[-1], "step_n": figures["step_n"], "slope": figures["slope"], "once": once}
    return [Job(job.case, "five_equal", {**asked, "interframe": i}) for i in ("auto", "off")]


def curve_jobs(chosen: Sequence[Case], effort: str) -> list[Job]:
    """The points of the picture."""
    made = []
    for case in chosen:
        made.append(Job(case, "curve_paper"))
        for step in STEPS_N:
            made += [
                Job(case, "curve", {"effort": effort, "step_n": step}),
                Job(case, "curve_peers", {"step_n": step}),
            ]
    return made


def drawn_cases(chosen: Sequence[Case], pool: Pool) -> list[Case]:
    """A band and a height field at n_w 6, or at the largest n_w that there is: those of the most voxels."""
    depth = [case for case in chosen if case.kind in ("band", "height")] or list(chosen[:1])
    sides = {case.nw for case in depth}
    side = PICTURE_NW if PICTURE_NW in sides else max(sides)
    largest: dict[str, Case] = {}
    for case in sorted((c for c in depth if c.nw == side), key=pool.voxels):
        largest[case.kind] = case
    return sorted(largest.values(), key=lambda case: case.kind)


def warm(pool: Pool, chosen: Sequence[Case], efforts: Sequence[str]) -> None:
    """Compile all that coder `touch` needs, once, on the smallest field; the other processes find it in the cache."""
    frames = min(chosen, key=pool.voxels).frames(pool.keep.fields)[:2]
    for effort in efforts:
        pool.say(f"compiling {effort}")
        ours.touch(frames, effort=effort)
        ours.touch(frames, effort=effort, mode="nmse", step_n=0.1)


def speeds(report: Report, pool: Pool, chosen: Sequence[Case]) -> None:
    """Table 5, with the machine to itself; effort max, which is slow, over two frames once."""
    for case in chosen:
        frames = case.frames(pool.keep.fields)
        for effort in report.efforts:
            pool.say(f"{case.title}: speed of {effort}")
            key = [pool.digests[case.title][0], effort, fingerprint("ours"), "speed"]
            row = pool.keep.get(f"{case.title}-speed", key)
            if row is None:
                row = ours.speed(frames[:2], effort, 1) if effort == "max" else ours.speed(frames, effort)
                pool.keep.put(f"{case.title}-speed", key, row)
            report.add_speed(case, effort, row)


def fill(report: Report, pool: Pool, chosen: Sequence[Case]) -> None:
    """Tables 1 to 4 of what was found."""
    for case in chosen:

        def of(name: str, case: Case = case) -> Figures | None:
            return pool.found.get((case.title, name))

        if (one := of("equal")) is not None:
            report.add_equal(case, one, of("equal_peers"))
        if (one := of("promise")) is not None:
            report.add_promise(case, one, of("promise_peers"))
        for at, part in (("NMSE", "five_equal"), ("promise", "five_promise")):
            auto, off = of(f"{part} auto"), of(f"{part} off")
            if auto is not None and off is not None:
                report.add_five(case, at, auto, off, of(f"{part}_peers"), pool.count(case))
    report.compare_efforts()


def curves_of(pool: Pool, chosen: Sequence[Case], effort: str) -> dict[str, dict[str, list[list[float]]]]:
    """Points [NMSE in dB, bytes] of each coder by falling error, for each field."""
    curves = {}
    for case in chosen:
        of: dict[str, list[list[float]]] = {}
        for job in curve_jobs([case], effort):
            for name, points in (pool.found[case.title, job.name] or {}).items():
                if name != "seconds":
                    of.setdefault(name, []).extend(points)
        curves[case.title] = {name: sorted(points, reverse=True) for name, points in of.items()}
    return curves


def falling(report: Report, pool: Pool, nw: int) -> None:
    """2000 frames as objects against voxels by coder `paper`; of the voxels eight frames in 250 are coded."""
    key = ["falling", nw, fingerprint("ours"), fingerprint("fields")]
    found = pool.keep.get("objects", key)
    if found is None:
        scene, medium = falling_objects(nw)
        groups = [[medium[i] for i in range(start, start + 8)] for start in range(0, len(medium) - 7, 250)]
        a_frame = float(np.mean([ours.paper(group).bytes / len(group) for group in groups]))
        found = {"voxels": a_frame * len(medium), "objects": ours.object_bytes(scene)}
        pool.keep.put("objects", key, found)
    report.add_objects(found["voxels"], nw, found["objects"])


def arguments() -> Any:
    """What was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one field at n_w 6")
    parser.add_argument("--nw", type=int, nargs="+", default=list(SIDES))
    parser.add_argument("--fields", nargs="+", help="names such as 'tum band'")
    parser.add_argument("--efforts", nargs="+", default=list(EFFORTS), choices=EFFORTS)
    parser.add_argument("--picture", type=Path, help="where to draw; by default only a full run does")
    parser.add_argument("--only-picture", action="store_true", help="of the comparisons only what the picture shows")
    parser.add_argument("--keep", type=Path, help="a folder of figures, to go on from")
    parser.add_argument(
        "--data", type=Path, default=SHARED, help="the optional real inputs, by default ../shared/data"
    )
    return parser.parse_args()


def main() -> None:
    """Print the tables, keep the figures, draw the picture."""
    asked = arguments()
    sides = (6,) if asked.quick else tuple(asked.nw)
    names = ("tum band", "motorcycle band") if asked.quick else asked.fields and tuple(asked.fields)
    efforts = tuple(e for e in EFFORTS if e in asked.efforts)
    is_full = not (asked.quick or asked.fields or asked.only_picture) and efforts == EFFORTS and sides == SIDES
    picture: Path | None = asked.picture or (RESULTS / "rate.png" if is_full else None)
    with (
        tempfile.TemporaryDirectory(prefix="touchfield-rate-") as scratch,
        Pool(Keep(asked.keep or Path(scratch))) as pool,
    ):
        failed = measured(asked, pool, list(cases(sides, names, asked.data)), efforts, picture, is_full)
    sys.exit(failed)


def measured(
    asked: Any, pool: Pool, chosen: list[Case], efforts: tuple[str, ...], picture: Path | None, is_full: bool
) -> int:
    """Everything that was asked for; 1 if a part has failed."""
    began, report = time.perf_counter(), Report(efforts)
    is_real = asked.data.is_dir()
    where = "TUM desk and ICL living room" if is_real else "the samples (../shared/data is not there)"
    pool.say(f"fields: {where}; a band's wall is {WALL_VOXELS} voxels of the mean spacing; Phantom Omni, 500 N/m")
    pool.say(f"not installed: {', '.join(peers.absent()) or 'none'}")
    pool.prepare(chosen)
    warm(pool, chosen, efforts)
    if not asked.quick and not asked.only_picture:
        speeds(report, pool, [case for case in chosen if case.nw == 7 and case.kind in ("band", "height")])
        if not asked.fields:
            falling(report, pool, max(case.nw for case in chosen))
    drawn = drawn_cases(chosen, pool) if picture is not None else []
    jobs = [job for case in chosen for job in jobs_of(case, efforts, pool.count(case))]
    if asked.only_picture:
        jobs = [job for job in jobs if job.part in ("promise", "promise_peers") and job.case in drawn]
    pool.run(
        [*jobs, *curve_jobs(drawn, efforts[-1])],
        lambda job, figures: after(job, figures, efforts, pool.count(job.case)),
    )
    fill(report, pool, chosen)
    for table in report.tables():
        print(table)
    lost = peers.absent()
    print(f"\npeers that are not installed: {', '.join(lost) or 'none'}")
    for name in pool.failed:
        print(f"FAILED: {name}")
    curves = curves_of(pool, drawn, efforts[-1])
    if picture is not None:
        from rate_picture import draw

        draw(curves, {row["field"]: row for row in report.promise.kept}, picture)
    if is_full:
        figures = {"tables": {t.title: t.kept for t in report.tables()}, "curves": curves, "failed": pool.failed}
        told = {"fields": where, "wall_voxels": WALL_VOXELS, "k": ours.K, "f0_n": ours.F0_N, "absent": lost}
        keep("rate", {**told, **figures, "seconds": time.perf_counter() - began})
    pool.say("done")
    return int(bool(pool.failed))


if __name__ == "__main__":
    main()
