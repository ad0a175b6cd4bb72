"""The tables of `rate.py`, its bars, and how far the best peer is behind."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from machine import Bar, at_least, at_most, table
from rate_ours import STRONGEST
from rate_symbols import F0_N, K

Figures = dict[str, Any]
DEFAULT = "default"
MEAN_DEFAULT, MEAN_STRONGEST, WORST_STRONGEST, P_OVER_I = 1.0, 1.12, 1.25, 1.0
"""Over the figures before: bytes on the mean of the fields, and at worst; later frames over frames coded alone."""
SPEEDS = {
    ("tum band", DEFAULT, "decode"): 60, ("tum band", DEFAULT, "encode"): 12, ("icl band", DEFAULT, "decode"): 30,
    ("icl band", DEFAULT, "encode"): 8, ("tum band", STRONGEST, "decode"): 15, ("icl band", STRONGEST, "decode"): 5,
    ("tum band", "fast", "encode"): 40, ("icl band", "fast", "encode"): 20,
}  # fmt: skip
"""Frames a second at 128^3 on two cores, at least."""
SAME_DB = 0.1
"""Errors nearer than this are compared."""
TITLES = {
    ("NMSE", 1): "1. One frame at the NMSE of coder paper: bytes",
    ("promise", 1): f"2. One frame, |e| <= max({F0_N:g} N, {K:g} |F|): bytes; the peers keep it too",
    ("NMSE", 5): "3. Five frames in a segment at the NMSE of coder paper: bytes of all",
    ("promise", 5): "4. Five frames in a segment at the promise: bytes of all",
}


def whole(size: float | None) -> str:
    """Bytes, or a dash."""
    return "-" if size is None or not math.isfinite(size) else f"{size:,.0f}"


def times(value: float | None) -> str:
    """A ratio, or a dash."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def best(sizes: Figures) -> tuple[str, float]:
    """The smallest that is a number."""
    known = [(size, name) for name, size in sizes.items() if math.isfinite(size)]
    size, name = min(known, default=(math.nan, "-"))
    return name, size


def mean(ratios: Sequence[float]) -> float | None:
    """Geometric; None of nothing."""
    return math.exp(sum(map(math.log, ratios)) / len(ratios)) if ratios else None


@dataclass
class Report:
    """What was found.

    A row of `sizes` has "field", "kind", "at" ("NMSE" or "promise"), "frames", "nmse_db", "touch" by effort (bytes),
    "p_over_i" by effort, "peers" and what else its parts told; one of `speeds` has "field", "effort" and the figures
    of `rate_ours.speed`; `before` are the figures that the bars are held against.
    """

    efforts: tuple[str, ...]
    before: Figures
    sizes: list[Figures] = field(default_factory=list)
    speeds: list[Figures] = field(default_factory=list)
    objects: dict[str, float] = field(default_factory=dict)
    curves: dict[str, Figures] = field(default_factory=dict)

    def at(self, at: str, frames: int) -> list[Figures]:
        """The rows of a table."""
        return [row for row in self.sizes if row["at"] == at and (row["frames"] > 1) is (frames > 1)]

    def tables(self) -> Iterator[str]:
        """Those that hold anything."""
        ends = ("best peer", "bytes", "over default", "over strongest", "coded source", "on paper's symbols")
        head = ("field", "NMSE dB", "paper", *self.efforts, "P over I", "beyond", "worst", *ends)
        for (at, frames), title in TITLES.items():
            if rows := [self._cells(row) for row in self.at(at, frames)]:
                yield table(title, head, rows)

    def _cells(self, row: Figures) -> tuple[str, ...]:
        name, size = best(row["peers"])
        touch, (on, on_size) = row["touch"], best(row.get("on_paper", {}))
        return (
            row["field"], f"{row['nmse_db']:.1f}", whole(row.get("paper")),
            *(whole(touch.get(e)) for e in self.efforts), times(row["p_over_i"].get(STRONGEST)),
            str(row.get("beyond", "-")), times(row.get("worst")),
            name, whole(size), *(times(size / touch.get(e, math.nan)) for e in (DEFAULT, STRONGEST)),
            whole(row["peers"].get("coded source")), f"{whole(on_size)} {on}",
        )  # fmt: skip

    def _ratios(
        self, at: str, frames: int, over: Callable[[Figures], Any], under: Callable[[Figures], Any]
    ) -> list[float]:
        pairs = [(over(row), under(row)) for row in self.at(at, frames)]
        return [a / b for a, b in pairs if a and b and math.isfinite(a / b)]

    def _former(self, row: Figures, effort: str) -> float | None:
        """Bytes of the same field before, if they were measured at the same error."""
        old = self.before[row["at"]].get(row["field"], {})
        return old.get(effort) if abs(old.get("nmse_db", row["nmse_db"]) - row["nmse_db"]) < SAME_DB else None

    def ranges(self) -> dict[str, list[float]]:
        """How many times as large as ours the best peer is over all fields, at least and at most."""
        found = {}
        for at, frames in TITLES:
            for effort in dict.fromkeys((DEFAULT, STRONGEST)):
                over = self._ratios(
                    at, frames, lambda r: best(r["peers"])[1], lambda r, e=effort: r["touch"].get(e)
                )  # fmt: skip
                if over:
                    found[f"{effort}, {at}, {frames} frame{'s' * (frames > 1)}"] = [min(over), max(over)]
        return found

    def bars(self) -> list[Bar]:
        """Beside the figures before, the best peer, and frames a second."""
        made: list[Bar] = []
        for at in ("promise", "NMSE"):
            for effort, old, most in ((DEFAULT, "default", MEAN_DEFAULT), (STRONGEST, "max", MEAN_STRONGEST)):
                over = self._ratios(at, 1, lambda r, e=effort: r["touch"].get(e), lambda r, o=old: self._former(r, o))
                told = f"{at}, one frame: bytes of {effort} over the former {old}, {len(over)} fields"
                made.append(at_most(f"{told}, mean", mean(over), most))
                if old == "max":
                    made.append(at_most(f"{told}, worst", max(over, default=None), WORST_STRONGEST))
            former = self.before[f"p_over_i, {at}"]
            over = self._ratios(at, 5, lambda r: r["p_over_i"].get(STRONGEST), lambda r, f=former: f.get(r["field"]))
            told = f"{at}, five frames: P over I of {STRONGEST} over the former, {len(over)} fields, mean"
            made.append(at_most(told, mean(over), P_OVER_I))
        beyond = [row["beyond"] for row in self.sizes if row["at"] == "promise"]
        made.append(at_most("voxels beyond the mask, all efforts", sum(beyond) if beyond else None, 0))
        for name, (least, _) in self.ranges().items():
            made.append(at_least(f"bytes of the best peer over ours: {name}", least, 1.0))
        speeds = {(row["field"], row["effort"]): row for row in self.speeds}
        for (name, effort, what), least in SPEEDS.items():
            row = speeds.get((f"{name}, nw 7", effort), {})
            told, measured = f"{name}, 128^3, two cores: {effort} {what}s", row.get(f"{what}_frames_s")
            made.append(at_least(told, measured, least, "frames/s"))
        return made
