"""Size against error: coder `touch` beside coder `paper` and general-purpose coders, everything counted.

    python bench/rate.py [--quick] [--nw 5 6 7] [--fields NAME ...] [--efforts fast default max] [--picture FILE]

Three comparisons, each with its bar: the bytes of one frame at the NMSE of coder `paper` (n_q 6, 258 directions, no
deadband); the bytes of one frame under the promise |e| <= max(F_0, k |F|), k = 0.1 and F_0 = 0.05 N, which every peer
keeps too; and both for five frames in one segment. Then the speed of each effort, and falling bodies as objects.
`--quick` takes one field at n_w 6. A peer that is not installed is named and left out. The table goes to the standard
output, progress to the standard error; a full run also writes ``results/rate.json`` and ``results/rate.png``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import rate_ours as ours
import rate_peers as peers
from machine import RESULTS, keep
from rate_contest import peers_at_error, peers_at_promise
from rate_fields import FRAMES, SHARED, WALL_VOXELS, Case, Scratch, Volume, cases, falling_objects
from rate_tables import Table, best, met, times
from touchfield.medium import ForceField

K, F0_N = ours.K, ours.F0_N
SIDES = (5, 6, 7)
EFFORTS = ("fast", "default", "max")
OVER_PAPER = {"band": 4.0, "height": 80.0, "falling": 11.0}
"""Bars at n_w 7: how many times smaller than coder `paper` at its NMSE."""
OVER_PEER = {"band": 1.75, "height": 1.7}
PROMISE_OVER_PEER = {"band": 2.0, "height": 1.8}
FIVE_OVER_PEER, P_OVER_I = 1.6, 0.75
WITHIN = {"fast": 1.5, "default": 1.2}
"""Bytes of an effort over those of max."""
SPEEDS = {
    ("max", "band"): (1, 1),
    ("default", "band"): (10, 30),
    ("default", "height"): (10, 10),
    ("fast", "band"): (30, 100),
    ("fast", "height"): (30, 100),
}
"""Frames a second, encode and decode, at 128^3 on two cores."""
OBJECTS_OVER_PAPER = 300.0


# -- the comparisons ------------------------------------------------------------------------------------------


class Run:
    """The tables of one run."""

    def __init__(self, efforts: tuple[str, ...], scratch: Scratch) -> None:
        self.efforts, self.scratch = efforts, scratch
        ends = ("best peer", "bytes", "over peer (bar)", "met")
        sizes = tuple(f"touch {e}" for e in efforts)
        self.equal = Table(
            "1. One frame at the NMSE of coder paper: bytes",
            ("field", "NMSE dB", "paper", *sizes, "paper over ours (bar)", "met", *ends),
        )
        self.promise = Table(
            f"2. One frame, |e| <= max({F0_N:g} N, {K:g} |F|): bytes; the peers keep it too",
            ("field", *sizes, "beyond", "worst", *ends),
        )
        self.five = Table(
            f"3. {FRAMES} frames in a segment: bytes a frame, at the NMSE of coder paper and at the promise",
            ("field", "at", f"touch {efforts[-1]}", "all I", "never worse", "P over I (bar)", "met", *ends),
        )
        self.efforts_table = Table(
            "4. Efforts: bytes over those of max (bar), all fields", ("at", "effort", "mean", "worst (bar)", "met")
        )
        self.speed = Table(
            "5. Speed at the promise, 128^3, all cores: frames a second (bars are of two cores)",
            ("field", "effort", "encode (bar)", "decode (bar)", "bytes a frame", "met"),
        )
        self.objects = Table(
            "6. Falling bodies, 2000 frames: bytes", ("as", "bytes", "paper's voxels over it (bar)", "met")
        )

    def tables(self) -> Iterator[Table]:
        """Those that hold anything."""
        yield from (
            t for t in (self.equal, self.promise, self.five, self.efforts_table, self.speed, self.objects) if t.rows
        )

    def field(self, case: Case) -> None:
        """One field through comparisons 1 to 3."""
        frames = case.frames(self.scratch.path)
        first, moving = Volume.of(frames[:1]), Volume.of(frames)
        self._equal(case, frames[:1], first)
        self._promise(case, frames[:1], first)
        if len(frames) > 1:
            self._five(case, frames, moving)

    def _equal(self, case: Case, frames: list[ForceField], volume: Volume) -> None:
        paper = ours.paper(frames)
        sizes = {e: ours.touch_at_error(frames, paper.nmse_db, e) for e in self.efforts}
        found = peers_at_error(volume, paper.nmse_db)
        mine, (name, size) = sizes[self.efforts[-1]], best(found)
        bars = (OVER_PAPER.get(case.kind), OVER_PEER.get(case.kind)) if case.nw == 7 else (None, None)
        self.equal.add(
            (
                case.title,
                f"{paper.nmse_db:.1f}",
                f"{paper.bytes:,}",
                *(f"{sizes[e]:,.0f}" for e in self.efforts),
                times(paper.bytes / mine, bars[0]),
                met(paper.bytes / mine, bars[0]),
                name,
                f"{size:,.0f}",
                times(size / mine, bars[1]),
                met(size / mine, bars[1]),
            ),
            field=case.title, kind=case.kind, nmse_db=paper.nmse_db, paper=paper.bytes, touch=sizes, peers=found,
        )  # fmt: skip

    def _promise(self, case: Case, frames: list[ForceField], volume: Volume) -> None:
        made = {e: ours.touch(frames, effort=e) for e in self.efforts}
        found = peers_at_promise(volume)
        mine, (name, size) = made[self.efforts[-1]], best(found)
        bar = PROMISE_OVER_PEER.get(case.kind)
        beyond = sum(m.beyond for m in made.values())
        self.promise.add(
            (
                case.title,
                *(f"{made[e].bytes:,}" for e in self.efforts),
                f"{beyond}",
                f"{max(m.worst for m in made.values()):.3f}",
                name,
                f"{size:,.0f}",
                times(size / mine.bytes, bar),
                met(size / mine.bytes, bar) if not beyond else "NO",
            ),
            field=case.title, kind=case.kind, touch={e: m.bytes for e, m in made.items()}, beyond=beyond,
            nmse_db=mine.nmse_db, peers=found,
        )  # fmt: skip

    def _five(self, case: Case, frames: list[ForceField], volume: Volume) -> None:
        effort = self.efforts[-1]
        target_db = ours.paper(frames, interframe="none").nmse_db
        sizes = [ours.touch_at_error(frames, target_db, effort, interframe=i) for i in ("auto", "off")]
        found = peers_at_error(volume, target_db)
        self._five_row(case, "NMSE", sizes[0], sizes[1], None, found, len(frames))
        auto, off = (ours.touch(frames, effort=effort, interframe=i) for i in ("auto", "off"))
        found = peers_at_promise(volume)
        of_i = sum(off.frame_bits[1:])
        ratio = sum(auto.frame_bits[1:]) / of_i if of_i else None
        self._five_row(case, "promise", auto.bytes, off.bytes, ratio, found, len(frames))

    def _five_row(
        self, case: Case, at: str, auto: float, off: float, ratio: float | None, found: dict[str, float], count: int
    ) -> None:
        name, size = best(found)
        bar = P_OVER_I if case.name.startswith("tum") and ratio is not None else None
        told = "-" if ratio is None else f"{ratio:.2f}" + (f" ({bar:g})" if bar else "")
        self.five.add(
            (
                case.title, at, f"{auto / count:,.0f}", f"{off / count:,.0f}", met(auto, 1.002 * off, most=True),
                told, met(ratio, bar, most=True), name, f"{size / count:,.0f}", times(size / auto, FIVE_OVER_PEER),
                met(size / auto, FIVE_OVER_PEER),
            ),
            field=case.title, kind=case.kind, at=at, touch=auto, all_i=off, p_over_i=ratio, peers=found, frames=count,
        )  # fmt: skip

    def compare_efforts(self) -> None:
        """How much larger the quicker efforts are."""
        for at, table in (("NMSE", self.equal), ("promise", self.promise)):
            for effort in self.efforts[:-1]:
                over = np.array([row["touch"][effort] / row["touch"][self.efforts[-1]] for row in table.kept])
                over = over[np.isfinite(over)]
                if not len(over):
                    continue
                mean, worst, bar = float(np.exp(np.log(over).mean())), float(over.max()), WITHIN.get(effort)
                self.efforts_table.add(
                    (at, effort, times(mean), times(worst, bar), met(worst, bar, most=True)),
                    at=at, effort=effort, mean=mean, worst=worst,
                )  # fmt: skip

    def speeds(self, case: Case) -> None:
        """Each effort on one field."""
        frames = case.frames(self.scratch.path)
        for effort in self.efforts:
            row = ours.speed(frames, effort)
            bars = SPEEDS.get((effort, case.kind), (None, None))
            reached = [met(row[key], bar) for key, bar in zip(("encode_frames_s", "decode_frames_s"), bars)]
            told = [
                f"{row[key]:.1f}" + (f" ({bar})" if bar else "")
                for key, bar in zip(("encode_frames_s", "decode_frames_s"), bars)
            ]
            self.speed.add(
                (case.title, effort, *told, f"{row['bytes_a_frame']:,.0f}", "NO" if "NO" in reached else reached[0]),
                field=case.title, effort=effort, **row,
            )  # fmt: skip

    def falling(self, nw: int) -> None:
        """2000 frames as objects against voxels by coder `paper`; of the voxels eight frames in 250 are coded."""
        scene, medium = falling_objects(nw)
        groups = [[medium[i] for i in range(start, start + 8)] for start in range(0, len(medium) - 7, 250)]
        a_frame = float(np.mean([ours.paper(group).bytes / len(group) for group in groups]))
        voxels = a_frame * len(medium)
        self.objects.add((f"voxels, coder paper, nw {nw}", f"{voxels:,.0f}", "1x", "-"), bytes=voxels)
        for name, size in ours.object_bytes(scene).items():
            over = voxels / size
            self.objects.add(
                (name, f"{size:,}", times(over, OBJECTS_OVER_PAPER), met(over, OBJECTS_OVER_PAPER)),
                name=name,
                bytes=size,
            )


def main() -> None:
    """Print the tables, keep the figures, draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one field at n_w 6")
    parser.add_argument("--nw", type=int, nargs="+", default=list(SIDES))
    parser.add_argument("--fields", nargs="+", help="names such as 'tum band'")
    parser.add_argument("--efforts", nargs="+", default=list(EFFORTS), choices=EFFORTS)
    parser.add_argument("--picture", type=Path, help="where to draw; by default only a full run does")
    asked = parser.parse_args()
    sides, names = (
        ((6,), ("tum band", "motorcycle band"))
        if asked.quick
        else (tuple(asked.nw), asked.fields and tuple(asked.fields))
    )
    began, scratch = time.perf_counter(), Scratch()
    run = Run(tuple(e for e in EFFORTS if e in asked.efforts), scratch)
    chosen = list(cases(sides, names))
    where = (
        "TUM desk and ICL living room"
        if SHARED.is_dir()
        else "the samples of the package (../shared/data is not there)"
    )
    print(
        f"fields: {where}; a band's wall is {WALL_VOXELS} voxels of the mean spacing; Phantom Omni, 500 N/m",
        file=sys.stderr,
    )
    print(f"not installed: {', '.join(peers.absent()) or 'none'}", file=sys.stderr)
    for n, case in enumerate(chosen):
        told = f"[{n + 1}/{len(chosen)}, {time.perf_counter() - began:.0f} s] {case.title}"
        print(told, file=sys.stderr, flush=True)
        run.field(case)
    run.compare_efforts()
    if not asked.quick:
        for case in chosen:
            if case.nw == 7 and case.kind in ("band", "height"):
                run.speeds(case)
        if not names:
            run.falling(max(sides))
    for table in run.tables():
        print(table)
    lost = peers.absent()
    print(f"\npeers that are not installed: {', '.join(lost) or 'none'}")
    is_full = not asked.quick and not asked.fields and run.efforts == EFFORTS and sides == SIDES
    picture: Path | None = asked.picture or (RESULTS / "rate.png" if is_full else None)
    curves = {}
    if picture is not None:
        from rate_picture import draw, drawn_cases, size_curves

        for case in drawn_cases(chosen):
            print(f"[{time.perf_counter() - began:.0f} s] curves of {case.title}", file=sys.stderr, flush=True)
            curves[case.title] = size_curves(case.frames(scratch.path)[:1], run.efforts[-1])
        draw(curves, picture)
    if is_full:
        figures = {"tables": {t.title: t.kept for t in run.tables()}, "curves": curves}
        told = {"fields": where, "wall_voxels": WALL_VOXELS, "k": K, "f0_n": F0_N, "absent": lost}
        keep("rate", {**told, **figures, "seconds": time.perf_counter() - began})


if __name__ == "__main__":
    main()
