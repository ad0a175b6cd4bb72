"""Table 3 of the paper: what the deadband k, m frames and the fineness of directions do to CR and NMSE."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from touchfield.experiments.experiment import Experiment, Finding, Inputs, markdown_table
from touchfield.experiments.table_3_printed import FRACTIONS, FRAME_COUNTS, PRINTED, impossibility
from touchfield.experiments.trends import TRENDS, Case, Point, trends

if TYPE_CHECKING:
    from touchfield.experiments.coding import Coded
    from touchfield.experiments.table_3_runs import Runs, SequenceRuns

__all__ = ["EXPERIMENT"]

NW, NQ = 6, 6

INTRODUCTION: Final = f"""\
n_w and n_q are not stated for this table: n_w = {NW} and n_q = {NQ} are taken here ([figure 9](#figure-9) varies
both). The paper's generator of forces is not stated either; the depth frames are made force fields in three ways:

- *wall, world*: a wall of some millimetres behind what the camera saw, in the coordinates of the first camera: the
  poses are used, so that a moving camera sees a standing world;
- *wall, camera*: the same, each frame in its own camera, which is all that the paper could have done without poses;
- *solid, camera*: the frame as a height map, everything behind the surface solid: closest to the paper's words.

*Literal* is eq. 8 on amplitudes as printed (a held sample has no direction of its own), 258 directions, and the open
difference of two frames. *Corrected* gates the vector against what the decoder holds, takes 252 directions, and codes
a frame as a difference in closed loop or alone, whichever is smaller. CR counts C_a + C_d as eq. 9 does; *CR full* is
the whole file. The four decibels are eq. 10 in the conventions that the paper may have meant, in this order:
10 log10 NMSE, 10 log10 L, 20 log10 L, 20 log10 NMSE, with NMSE the ratio of the sums of squares and L that of the
sums of norms. *Beyond* is the share of voxels whose error leaves the mask max(F_0, k |F|).
"""


def run(inputs: Inputs) -> Finding:
    """Every setting of table 3 on every depth sequence, the trends, and what keeps them from holding."""
    from touchfield.experiments.scenes import depth_inputs
    from touchfield.experiments.table_3_picture import draw_gain
    from touchfield.experiments.table_3_runs import Settings, run_sequence, steps

    settings = Settings(4, NQ, FRACTIONS, (1, 2)) if inputs.quick else Settings(NW, NQ, FRACTIONS, FRAME_COUNTS)
    sources = depth_inputs(inputs)
    total = sum(steps(settings, one.sequence.poses is not None) for one in sources)
    done = iter(range(1, total + 1))
    found = tuple(run_sequence(one, settings, lambda: inputs.report(next(done), total)) for one in sources)
    picture = draw_gain(inputs.folder / "table3.png", found)
    return Finding(_page(found, inputs.quick), _data(found, settings.nw), (picture,))


def _page(found: tuple[SequenceRuns, ...], is_quick: bool) -> str:
    parts = [INTRODUCTION]
    if is_quick:
        parts.append("**A quick trial: n_w = 4 and at most two frames.**\n")
    parts += ["### What several frames save\n", "![CR of m frames over that of one](table3.png)\n"]
    parts += ["### The printed multi-frame figures cannot be\n", impossibility()]
    parts += ["### The trends\n", _trend_table(found)]
    parts += ["### What makes frames differ\n", _cause_table(found)]
    parts += ["### Why trends fail\n", _reason_table(found)]
    for one in found:
        parts.append(f"### The table on {one.name}\n")
        size = f"{one.size_px[0]} x {one.size_px[1]} pixels"
        parts.append(f"{size}; noise {one.noise_mm:.2g} mm at the median depth. {' '.join(_sentence(one.notes))}\n")
        for runs in one.variants:
            parts.append(f"{one.name}, {runs.variant}; {runs.support_share:.1%} of the voxels hold a force:\n")
            parts.append(_table(runs))
    return "\n".join(parts)


def _sentence(notes: tuple[str, ...]) -> list[str]:
    return [f"{note[:1].upper()}{note[1:].rstrip('.')}." for note in notes]


# -- the table ------------------------------------------------------------------------------------------------


def _table(runs: Runs) -> str:
    head = ["m", "k", "directions", "CR printed", "literal", "corrected", "CR full", "dB printed", "literal"]
    head += ["corrected", "beyond, corrected", "why they differ"]
    rows = []
    for case, printed in PRINTED.items():
        if case not in runs.coded["literal"]:
            continue
        literal, corrected = runs.coded["literal"][case], runs.coded["corrected"][case]
        rows.append([
            case.m, f"{case.k:g}", "high" if case.is_high else "low",
            f"{printed.cr:.5f}", f"{literal.cr_literal:.5f}", f"{corrected.cr_literal:.5f}", f"{corrected.cr_full:.5f}",
            f"{printed.nmse_db:.1f}", _decibels(literal), _decibels(corrected),
            f"{corrected.beyond_mask:.1%}", _why(case, printed, literal),
        ])  # fmt: skip
    return markdown_table(head, rows)


def _decibels(coded: Coded) -> str:
    return " / ".join(f"{value:.1f}" for value in coded.decibels.values())


def _why(case: Case, printed: Point, literal: Coded) -> str:
    """One line on the distance to the printed figures, from measured quantities."""
    name, value = min(literal.decibels.items(), key=lambda named: abs(named[1] - printed.nmse_db))
    nearest = f"dB nearest as {name}, {value - printed.nmse_db:+.1f} dB"
    if case.m > 1:
        least = PRINTED[case._replace(m=1)].cr / case.m
        return f"printed CR is below its own CR(1)/m = {least:.4f}; {nearest}"
    needed = printed.cr * 96 / literal.bits_per_sent if literal.bits_per_sent else 0.0
    return (
        f"printed CR has {needed:.1%} of the voxels sent at our {literal.bits_per_sent:.1f} bits each, "
        f"ours {literal.sent_per_voxel:.1%}; {nearest}"
    )


# -- trends and reasons ---------------------------------------------------------------------------------------


def _points(coded: dict[Case, Coded]) -> dict[Case, Point]:
    return {case: Point(one.cr_literal, one.nmse_db) for case, one in coded.items()}


def _trend_table(found: tuple[SequenceRuns, ...]) -> str:
    rows = [["printed", "", "", *(trend.verdict for trend in trends(PRINTED))]]
    for one in found:
        for runs in one.variants:
            for reading, coded in runs.coded.items():
                verdicts = (trend.verdict for trend in trends(_points(coded)))
                rows.append([one.name, runs.variant, reading, *verdicts])
    text = (
        "Each is compared pair by pair over all settings of a table; NMSE as 10 log10, the order being the same in "
        "20 log10.\n\n"
    )
    return text + markdown_table(["sequence", "field", "reading", *TRENDS], rows)


def _reason_table(found: tuple[SequenceRuns, ...]) -> str:
    rows = []
    for one in found:
        for runs in one.variants:
            for reading, coded in runs.coded.items():
                points = _points(coded)
                for trend in trends(points):
                    if trend.holds or trend.name == "multi-frame CR below single-frame":
                        continue  # the latter fails for the reason of "CR falls with m"
                    figure, _ = TRENDS[trend.name]
                    worst = max(trend.failures, key=lambda pair: points[pair[1]][figure] - points[pair[0]][figure])
                    by = points[worst[1]][figure] - points[worst[0]][figure]
                    share = f"{by / points[worst[0]].cr:.1%}" if figure == 0 else f"{by:.2f} dB"
                    where = f"{worst[0].wording}, against {worst[1].wording}"
                    reason = _reason(trend.name, worst, one, runs, reading)
                    rows.append([one.name, runs.variant, reading, trend.name, f"{share} ({where})", reason])
    if not rows:
        return "All hold.\n"
    return markdown_table(["sequence", "field", "reading", "trend", "fails by at most", "measured reason"], rows)


def _reason(trend: str, worst: tuple[Case, Case], one: SequenceRuns, runs: Runs, reading: str) -> str:
    """What was measured that explains the worst failure of a trend."""
    coded = runs.coded[reading]
    first, second = coded[worst[0]], coded[worst[1]]
    if trend.startswith("CR falls with m"):
        k = worst[1].k
        noise = next((c for c in one.causes if "noise" in c.circumstance), None)
        said = f"; noise alone {noise.cost[reading][k]:.2f} in a wall" if noise else ""
        if reading == "literal":
            later = second.frames[1]
            grown = later.supported / max(1, second.frames[0].supported)
            return (
                f"the second frame's difference costs {second.bits(1) / max(1, second.bits(0)):.2f} of the first frame"
                f"{said}: it is not zero on {grown:.2f} times as many voxels, and its amplitudes and directions "
                "repeat less"
            )
        return f"frames were coded {second.kinds} (I alone, P difference): differences are no smaller{said}"
    if trend == "NMSE worsens with k":
        floor = runs.floors_db[reading][worst[0].is_high]
        return (
            f"nothing held leaves {floor:.1f} dB already, by the quantisers; frames were coded {second.kinds} at "
            f"k = {worst[1].k:g} and {first.kinds} at k = {worst[0].k:g}, and a P frame mends the error of the "
            "frame before"
        )
    return f"sent per supported voxel {_sent(first):.1%} and {_sent(second):.1%}; frames {first.kinds}, {second.kinds}"


def _sent(coded: Coded) -> float:
    return sum(f.sent for f in coded.frames) / max(1, sum(f.supported for f in coded.frames))


def _cause_table(found: tuple[SequenceRuns, ...]) -> str:
    head = ["sequence", "second frame"]
    rows = []
    fractions = list(found[0].causes[0].resent) if found and found[0].causes else []
    head += [f"resent, k = {k:g}" for k in fractions] + [f"P/I, k = {k:g}" for k in fractions]
    head += [f"D/I literal, k = {k:g}" for k in fractions]
    for one in found:
        for cause in one.causes:
            cells = [f"{cause.resent[k]:.1%}" for k in fractions]
            cells += [f"{cause.cost[reading][k]:.2f}" for reading in ("corrected", "literal") for k in fractions]
            rows.append([one.name, cause.circumstance, *cells])
    text = (
        "Share of the second frame's voxels that differ from the decoded first by more than a hand can feel, and the "
        "bits C_a + C_d of that frame over those of the first, when it is coded as a difference whatever it costs; "
        "walls, high directions. *Noise of the sensor* is a still view read twice: white noise of inverse depth, of "
        "the size that the sequence's own first frame shows.\n\n"
    )
    return text + markdown_table(head, rows)


# -- for programs ---------------------------------------------------------------------------------------------


def _data(found: tuple[SequenceRuns, ...], nw: int) -> dict[str, Any]:
    return {
        "nw": nw,
        "nq": NQ,
        "printed": [{**case._asdict(), **point._asdict()} for case, point in PRINTED.items()],
        "sequences": {one.name: _sequence_data(one) for one in found},
    }


def _sequence_data(one: SequenceRuns) -> dict[str, Any]:
    return {
        "noise_mm": one.noise_mm,
        "variants": {
            runs.variant: {
                "support_share": runs.support_share,
                "floors_db": {r: {"high": f[True], "low": f[False]} for r, f in runs.floors_db.items()},
                **{reading: [_case_data(c, v) for c, v in coded.items()] for reading, coded in runs.coded.items()},
                "trends": {r: {t.name: t.holds for t in trends(_points(c))} for r, c in runs.coded.items()},
            }
            for runs in one.variants
        },
        "causes": [
            {"circumstance": c.circumstance, "resent_by_k": c.resent, "cost_by_reading_and_k": c.cost}
            for c in one.causes
        ],
    }


def _case_data(case: Case, coded: Coded) -> dict[str, Any]:
    return {
        **case._asdict(),
        "cr_literal": coded.cr_literal,
        "cr_full": coded.cr_full,
        **{f"db {name}": value for name, value in coded.decibels.items()},
        "beyond_mask": coded.beyond_mask,
        "kinds": coded.kinds,
        "bits_per_frame": [coded.bits(i) for i in range(len(coded.frames))],
        "sent": [f.sent for f in coded.frames],
        "supported": [f.supported for f in coded.frames],
    }


EXPERIMENT = Experiment("table3", "Table 3: benefits of perceptual haptic filters", run)
