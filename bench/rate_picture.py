"""The picture of `rate.py`: size against error for all coders, one panel for each of two fields."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import rate_ours as ours
import rate_peers as peers
import rate_symbols as lattices
from rate_fields import Case, Volume
from touchfield.medium import ForceField

Curve = list[tuple[float, float]]
"""(NMSE in dB, bytes) by falling error."""

STEPS_N = (0.4, 0.24, 0.14, 0.08, 0.045, 0.025)
TOLERANCES = {"zfp": 8.0, "SZ3": 0.6, "SPERR": 0.7}
"""Times the steps: what takes each of the lossy coders over the same errors."""
PAPER = ((3, "ico3"), (4, "ico3"), (4, "octa3"), (6, "octa3"), (8, "ico10"), (8, "ico20"))
"""n_q and directions, coarse to fine."""

STYLES = {
    # Okabe and Ito's colours, which the colour-blind tell apart; ours are thick
    "touch": ("#000000", 3.0, "-"),
    "paper": ("#D55E00", 2.2, "-"),
    "zpaq -m5": ("#0072B2", 1.4, "-"),
    "xz": ("#56B4E9", 1.4, "-"),
    "zstd -19": ("#56B4E9", 1.1, "--"),
    "brotli": ("#0072B2", 1.1, ":"),
    "JPEG XL": ("#009E73", 1.4, "-"),
    "SZ3": ("#CC79A7", 1.4, "-"),
    "SPERR": ("#CC79A7", 1.4, "--"),
    "zfp": ("#E69F00", 1.4, "-"),
    "Draco": ("#8C6D1F", 1.4, "--"),
}


def drawn_cases(cases: Sequence[Case]) -> list[Case]:
    """A band and a height field at the largest n_w, as far as there are."""
    found = {}
    for case in sorted(cases, key=lambda c: c.nw):
        found[case.kind] = case if case.nw > getattr(found.get(case.kind), "nw", 0) else found[case.kind]
    return [found[kind] for kind in ("band", "height") if kind in found] or list(cases[:1])


def size_curves(frames: list[ForceField], effort: str) -> dict[str, Curve]:
    """Every coder on one field."""
    volume = Volume.of(frames)
    curves: dict[str, Curve] = {name: [] for name in STYLES}
    for step in STEPS_N:
        made = ours.touch(frames, mode="nmse", step_n=step, effort=effort)
        curves["touch"].append((made.nmse_db, float(made.bytes)))
        quantised = lattices.uniform(volume.forces_n, step)
        error = volume.nmse_db(quantised.decoded)
        for name, size in peers.lossless(quantised.symbols).items():
            curves[name].append((error, float(size)))
        cloud = peers.draco(quantised.symbols)
        if cloud is not None:
            curves["Draco"].append((error, float(cloud)))
        for name, code in peers.lossy().items():
            size, decoded = code(volume.forces_n, TOLERANCES[name] * step)
            curves[name].append((volume.nmse_db(decoded), float(size)))
        print(f"      step {step:g} N", file=sys.stderr, flush=True)
    for nq, directions in PAPER:
        made = ours.paper(frames, nq=nq, directions=directions)
        curves["paper"].append((made.nmse_db, float(made.bytes)))
    return {name: sorted(curve, reverse=True) for name, curve in curves.items() if curve}


def draw(curves: dict[str, dict[str, Curve]], out: Path) -> None:
    """Write the PNG: bytes of a frame against NMSE, both logarithmic; labels at the lines' ends."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure, axes = plt.subplots(1, len(curves), figsize=(1.2 + 5.6 * len(curves), 5.2), squeeze=False, dpi=120)
    for axis, (title, of) in zip(axes[0], curves.items()):
        ends = {}
        for name, curve in sorted(of.items(), key=lambda item: STYLES[item[0]][1]):
            shown = _within(curve)
            if not shown:
                continue
            colour, width, style = STYLES[name]
            axis.plot(*zip(*shown), style, color=colour, lw=width, marker="o", ms=1.2 + width, zorder=2 + width)
            ends[name] = shown[-1]
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_major_formatter(FuncFormatter(lambda size, _: f"{size:,.0f}"))
        axis.set_xlim(-8, -61)
        axis.set_xticks([-10, -20, -30, -40])
        _label(axis, ends)
        axis.set_title(f"{title}: one frame", loc="left", fontsize=12)
        axis.set_xlabel("error, NMSE in dB (finer to the right)")
        axis.grid(True, which="major", color="0.88", lw=0.6)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0][0].set_ylabel("bytes, everything counted")
    figure.tight_layout()
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out)
    plt.close(figure)


def _within(curve: Curve) -> Curve:
    """The part from -8 to -45 dB."""
    return [(db, size) for db, size in curve if -45.5 <= db <= -8]


def _label(axis, ends: dict[str, tuple[float, float]]) -> None:  # type: ignore[no-untyped-def]
    """Names right of all lines, pushed apart until none covers another, a thin line to the end of each."""
    low, high = np.log10(axis.get_ylim())
    gap = (high - low) / 21
    names = sorted(ends, key=lambda name: ends[name][1])
    places = [float(np.log10(ends[name][1])) for name in names]
    for _ in range(200):
        for i in range(len(places) - 1):
            short = gap - (places[i + 1] - places[i])
            if short > 0:
                places[i] -= short / 2
                places[i + 1] += short / 2
    for name, place in zip(names, places):
        colour, _, style = STYLES[name]
        axis.annotate(
            f"coder {name}" if name in ("touch", "paper") else name,
            xy=ends[name], xytext=(-49, 10**place), fontsize=12 if name == "touch" else 9.5, color=colour,
            va="center", fontweight="bold" if name == "touch" else "normal",
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.6, "ls": style, "shrinkB": 3, "alpha": 0.7},
        )  # fmt: skip
