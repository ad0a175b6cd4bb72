"""The tables of `rate.py` with the bars beside the figures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rate_fields import FRAMES, Case
from rate_ours import F0_N, K
from rate_tables import Table, best, met, times

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

Figures = dict[str, Any]
NONE = "-"


def whole(size: float | None) -> str:
    """Bytes, or a dash."""
    return NONE if size is None or not math.isfinite(size) else f"{size:,.0f}"


def _peer(peers: Figures | None) -> tuple[str, float]:
    return best(peers) if peers else (NONE, math.nan)


class Report:
    """The tables of one run."""

    def __init__(self, efforts: Sequence[str]) -> None:
        self.efforts = tuple(efforts)
        ends = ("best peer", "bytes", "over ours (bar)", "met")
        on_paper = ("best on paper's symbols", "bytes", "over ours")
        sizes = tuple(f"touch {e}" for e in self.efforts)
        self.equal = Table(
            "1. One frame at the NMSE of coder paper: bytes; beside it, paper's own symbols by general coders",
            ("field", "NMSE dB", "paper", *sizes, "paper over ours (bar)", "met", *ends, *on_paper),
        )
        self.promise = Table(
            f"2. One frame, |e| <= max({F0_N:g} N, {K:g} |F|): bytes; the peers keep it too",
            ("field", *sizes, "beyond", "worst", *ends),
        )
        self.five = Table(
            f"3. {FRAMES} frames in a segment: bytes a frame, at the NMSE of coder paper and at the promise",
            (
                *("field", "at", f"touch {self.efforts[-1]}", "all I", "never worse", "P over I (bar)", "met"),
                *(*ends, *on_paper),
            ),
        )
        self.compared = Table(
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
        every = (self.equal, self.promise, self.five, self.compared, self.speed, self.objects)
        yield from (table for table in every if table.rows)

    def add_equal(self, case: Case, ours: Figures, peers: Figures | None) -> None:
        """Comparison 1 of a field; peers that failed leave dashes."""
        touch, found = ours["touch"], peers or {"peers": {}, "on_paper": {}}
        mine, (name, size), (on, on_size) = (
            touch[self.efforts[-1]], _peer(found["peers"]), _peer(found["on_paper"]),
        )  # fmt: skip
        bars = (OVER_PAPER.get(case.kind), OVER_PEER.get(case.kind)) if case.nw == 7 else (None, None)
        over = ours["paper"] / mine
        self.equal.add(
            (
                case.title, f"{ours['nmse_db']:.1f}", whole(ours["paper"]), *(whole(touch[e]) for e in self.efforts),
                times(over, bars[0]), met(over, bars[0]),
                name, whole(size), times(size / mine, bars[1]), met(size / mine, bars[1]),
                on, whole(on_size), times(on_size / mine),
            ),
            field=case.title, kind=case.kind, nmse_db=ours["nmse_db"], paper=ours["paper"], touch=touch,
            trials=ours["trials"], **found,
        )  # fmt: skip

    def add_promise(self, case: Case, ours: Figures, peers: Figures | None) -> None:
        """Comparison 2 of a field."""
        touch, found = ours["touch"], (peers or {}).get("peers", {})
        mine, (name, size) = touch[self.efforts[-1]], _peer(found)
        bar, beyond = PROMISE_OVER_PEER.get(case.kind), ours["beyond"]
        self.promise.add(
            (
                case.title, *(whole(touch[e]) for e in self.efforts), f"{beyond}", f"{ours['worst']:.3f}",
                name, whole(size), times(size / mine, bar), "NO" if beyond else met(size / mine, bar),
            ),
            field=case.title, kind=case.kind, touch=touch, beyond=beyond, nmse_db=ours["nmse_db"],
            voxels=ours["voxels"], peers=found,
        )  # fmt: skip

    def add_five(self, case: Case, at: str, auto: Figures, off: Figures, peers: Figures | None, count: int) -> None:
        """A row of comparison 3: `at` "NMSE" or "promise"; `off` has no frame that follows from another."""
        found = peers or {}
        mine, (name, size) = auto["bytes"], _peer(found.get("peers"))
        on, on_size = _peer(found.get("on_paper"))
        ratio = auto["later_bits"] / off["later_bits"] if off["later_bits"] else None
        bar = P_OVER_I if case.name.startswith("tum") and ratio is not None else None
        told = NONE if ratio is None else f"{ratio:.2f}" + (f" ({bar:g})" if bar else "")
        over = size / mine
        self.five.add(
            (
                case.title, at, whole(mine / count), whole(off["bytes"] / count),
                met(mine, 1.002 * off["bytes"], most=True), told, met(ratio, bar, most=True),
                name, whole(size / count), times(over, FIVE_OVER_PEER), met(over, FIVE_OVER_PEER),
                on, whole(on_size / count), times(on_size / mine),
            ),
            field=case.title, kind=case.kind, at=at, touch=mine, all_i=off["bytes"], p_over_i=ratio, frames=count,
            **found,
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
                self.compared.add(
                    (at, effort, times(mean), times(worst, bar), met(worst, bar, most=True)),
                    at=at, effort=effort, mean=mean, worst=worst,
                )  # fmt: skip

    def add_speed(self, case: Case, effort: str, row: dict[str, float]) -> None:
        """A row of table 5."""
        both = tuple(zip(("encode_frames_s", "decode_frames_s"), SPEEDS.get((effort, case.kind), (None, None))))
        reached = [met(row[key], bar) for key, bar in both]
        told = [f"{row[key]:.1f}" + (f" ({bar})" if bar else "") for key, bar in both]
        self.speed.add(
            (case.title, effort, *told, whole(row["bytes_a_frame"]), "NO" if "NO" in reached else reached[0]),
            field=case.title, effort=effort, **row,
        )  # fmt: skip

    def add_objects(self, voxels: float, nw: int, sizes: dict[str, int]) -> None:
        """Table 6."""
        self.objects.add((f"voxels, coder paper, nw {nw}", whole(voxels), "1x", NONE), bytes=voxels)
        for name, size in sizes.items():
            over = voxels / size
            self.objects.add(
                (name, whole(size), times(over, OBJECTS_OVER_PAPER), met(over, OBJECTS_OVER_PAPER)),
                name=name, bytes=size,
            )  # fmt: skip
