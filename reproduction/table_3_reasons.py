"""Tests whether the trends of table 3 occur on each depth sequence, and reports the measured reason where one
does not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from reproduction.experiment import markdown_table
from reproduction.table_3_printed import PRINTED
from reproduction.table_3_runs import MOVING, NOISE, READINGS, STILL
from reproduction.trends import TRENDS, Case, Point, trends
from touchfield.codec.paper.directions import Codebook

if TYPE_CHECKING:
    from reproduction.coding import Coded
    from reproduction.table_3_runs import Runs, SequenceRuns

__all__ = ["cause_table", "points_of", "reason_table", "trend_table"]


def points_of(coded: dict[Case, Coded]) -> dict[Case, Point]:
    """The figures that trends are checked on: CR as eq. 9 counts, and 10 log10 NMSE."""
    return {case: Point(one.cr_literal, one.nmse_db) for case, one in coded.items()}


def trend_table(found: tuple[SequenceRuns, ...]) -> str:
    """Which trends hold, as Markdown: the printed figures first, then each sequence, field and reading."""
    rows = [["printed", "", "", *(trend.verdict for trend in trends(PRINTED))]]
    held = {reading: dict.fromkeys(TRENDS, 0) for reading in READINGS}
    for one in found:
        for runs in one.variants:
            for reading, coded in runs.coded.items():
                verdicts = trends(points_of(coded))
                rows.append([one.name, runs.variant, reading, *(trend.verdict for trend in verdicts)])
                for trend in verdicts:
                    held[reading][trend.name] += trend.holds
    tables = sum(len(one.variants) for one in found)
    for reading, counts in held.items():
        rows.append(["all", "", reading, *(f"holds in {count} of {tables}" for count in counts.values())])
    text = (
        "Each is compared pair by pair over all settings of a table; NMSE as 10 log10, the order being the "
        "same in "
        "20 log10.\n\n"
    )
    return text + markdown_table(["sequence", "field", "reading", *TRENDS], rows)


def reason_table(found: tuple[SequenceRuns, ...]) -> str:
    """The worst failure of each trend that fails, and the measured reason, as Markdown."""
    rows = []
    for one in found:
        for runs in one.variants:
            for reading, coded in runs.coded.items():
                points = points_of(coded)
                for trend in trends(points):
                    if trend.holds or trend.name == "multi-frame CR below single-frame":
                        continue  # the latter fails for the reason of "CR falls with m"
                    figure, _ = TRENDS[trend.name]
                    worst = max(
                        trend.failures, key=lambda pair: points[pair[1]][figure] - points[pair[0]][figure]
                    )
                    by = points[worst[1]][figure] - points[worst[0]][figure]
                    share = f"{by / points[worst[0]].cr:.1%}" if figure == 0 else f"{by:.2f} dB"
                    where = f"{worst[0].wording}, against {worst[1].wording}"
                    reason = _reason(trend.name, worst, one, runs, reading)
                    rows.append([one.name, runs.variant, reading, trend.name, f"{share} ({where})", reason])
    if not rows:
        return "All hold.\n"
    return markdown_table(
        ["sequence", "field", "reading", "trend", "fails by at most", "measured reason"], rows
    )


def _reason(trend: str, worst: tuple[Case, Case], one: SequenceRuns, runs: Runs, reading: str) -> str:
    """What was measured that explains the worst failure of a trend."""
    coded = runs.coded[reading]
    first, second = coded[worst[0]], coded[worst[1]]
    if trend.startswith("CR falls with m"):
        k = worst[1].k
        noise = next((c for c in one.causes if c.circumstance == NOISE), None)
        said = f"; noise alone {noise.cost[reading][k]:.2f} in a wall" if noise else ""
        if reading == "literal":
            before, later = second.frames[:2]
            return (
                f"the second frame's difference costs {second.bits(1) / max(1, second.bits(0)):.2f} of the "
                "first"
                f"{said}: it is not zero on {later.supported / max(1, before.supported):.2f} times as many "
                "voxels, "
                f"sends {later.sent / max(1, later.supported):.0%} of them against "
                f"{before.sent / max(1, before.supported):.0%}, at {second.bits(1) / max(1, later.sent):.1f} "
                "bits a "
                f"vector against {second.bits(0) / max(1, before.sent):.1f}"
            )
        later_bits = [second.bits(i) / max(1, second.bits(0)) for i in range(1, worst[1].m)]
        return (
            f"frames were coded {second.kinds}; later ones cost {np.mean(later_bits):.2f} of the first{said}"
        )
    if trend == "NMSE worsens with k":
        floor = runs.floors_db[reading][worst[0].is_high]
        return (
            f"nothing held leaves {floor:.1f} dB already, by the quantisers; frames were coded "
            f"{second.kinds} at "
            f"k = {worst[1].k:g} and {first.kinds} at k = {worst[0].k:g}, and a P frame mends the error of "
            "the "
            "frame before"
        )
    return (
        f"sent per supported voxel {_sent(first):.1%} and {_sent(second):.1%}; frames {first.kinds}, "
        f"{second.kinds}"
    )


def _sent(coded: Coded) -> float:
    return sum(f.sent for f in coded.frames) / max(1, sum(f.supported for f in coded.frames))


def cause_table(found: tuple[SequenceRuns, ...]) -> str:
    """What a second frame costs when the view stands still, when only noise changes, and when it moves."""
    head = ["sequence", "second frame"]
    rows = []
    fractions = list(found[0].causes[0].resent) if found and found[0].causes else []
    head += [f"resent, k = {k:g}" for k in fractions] + [f"P/I, k = {k:g}" for k in fractions]
    head += [f"D/I literal, k = {k:g}" for k in fractions]
    for one in found:
        for cause in one.causes:
            cells = [f"{cause.resent[k]:.1%}" for k in fractions]
            cells += [
                f"{cause.cost[reading][k]:.2f}" for reading in ("corrected", "literal") for k in fractions
            ]
            rows.append([one.name, cause.circumstance, *cells])
    codebook = Codebook.get("ico5")
    chord = 2 * math.sin(math.radians(codebook.covering_radius_deg) / 2)
    text = (
        "I is a frame coded alone, P the difference in closed loop, D the open difference of the literal "
        "reading. "
        "*Resent* is the share of the second frame's voxels that differ from the decoded first by more than "
        "the mask; P/I and D/I are the bits C_a + C_d of that frame over those of the first, when it is "
        "coded as a "
        "difference whatever it costs; walls, high directions. That so much of an unchanged frame is sent "
        "again at "
        f"small k is the quantiser's doing: {len(codebook)} directions are off by up to {chord:.1%} of the "
        "force, "
        "more than a mask of k = 0.1, and the difference mends that. *Noise of the sensor* is a still view "
        "read "
        "twice: white noise of inverse depth, of the size that the sequence's own first frame shows.\n\n"
    )
    return f"{text}{markdown_table(head, rows)}\n{_noise_shares(found)}"


def _noise_shares(found: tuple[SequenceRuns, ...]) -> str:
    """How much of the change that a moving camera makes is the sensor's noise, at the largest k."""
    lines = []
    for one in found:
        causes = {cause.circumstance: cause for cause in one.causes}
        if not causes:  # one frame alone
            continue
        noise = causes[NOISE]
        k = max(noise.resent)
        for name, cause in causes.items():
            if name.startswith(MOVING) and cause.resent[k]:
                lines.append(
                    f"- {one.name}, {name}: at k = {k:g}, where a still view without noise resends "
                    f"{causes[STILL].resent[k]:.1%}, noise alone makes "
                    f"{noise.resent[k] / cause.resent[k]:.0%} of "
                    "what is resent."
                )
    return "\n".join(lines) + "\n"
