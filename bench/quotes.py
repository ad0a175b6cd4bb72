"""Checks that README and the docs quote the same figures as the stored results of benchmarks, and updates
them.

    python bench/quotes.py [--write]

Lists the quoted phrases, the phrases that a page lacks, and the results that are stale. `--write` puts the
figures of the results into the pages. Speeds are quoted as ratios to a peer of the same run, because machines
change from day to day; only single queries are quoted in nanoseconds, with the kind of points. The exit
status is 1 if a page lacks a phrase, or if README quotes a stale result. README therefore quotes only what is
measured in minutes.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from machine import stale, stored

ROOT = Path(__file__).resolve().parents[1]
README, SCALE = "README.md", "docs/scale.md"


class Quote(NamedTuple):
    """A phrase of a page with {} for each figure, its figures, and their result."""

    page: str
    result: str
    phrase: str
    figures: tuple[str, ...]

    @property
    def text(self) -> str:
        """The phrase with its figures."""
        return self.phrase.format(*self.figures)

    @property
    def pattern(self) -> re.Pattern[str]:
        """A pattern of the phrase with any figures, across line ends."""
        parts = [re.sub(r"(?:\\ |\\\n)+", r"\\s+", re.escape(part)) for part in self.phrase.split("{}")]
        return re.compile(r"(\d[\d.,]*\d|\d)".join(parts))


def row(rows: Iterable[dict[str, Any]], **fields: Any) -> dict[str, Any]:
    """Return the only row with these fields."""
    (found,) = (row for row in rows if all(row[key] == value for key, value in fields.items()))
    return found


def query_quote() -> Quote:
    """Return the times of single queries in C, nanoseconds, with the kind of points."""
    query = stored("query")
    single, path_fraction = query["single"], query["batches"]["path"]["share"]
    points, path = single["compiled, in force"], single["compiled, path"]
    times = [f"{1000 * us:.0f}" for us in (points["p50_us"], points["p99.9_us"], path["p99.9_us"])]
    phrase = (
        "{} ns in the median and {} ns at p99.9 at random points with a force, "
        "and {} ns at p99.9 along a path of which {} % has a force"
    )
    return Quote(README, "query", phrase, (*times, f"{100 * path_fraction:.0f}"))


def speed_quotes() -> list[Quote]:
    """Return times of peers relative to touchfield."""
    depth, mesh, query = (stored(name) for name in ("depth", "mesh", "query"))
    peers = [f"{depth['128^3'][name]['ratio']:.0f}" for name in ("numpy", "warp")]
    fastest = min(peer["times_touchfield"] for peer in mesh["rows"].values() if "version" in peer)
    scipy = query["batches"]["path"]["times"]
    return [
        Quote(README, "depth", "{} times as fast as NumPy and {} times as fast as NVIDIA Warp", tuple(peers)),
        Quote(README, "mesh", "{} times as fast as the fastest", (f"{fastest:.1f}",)),
        Quote(README, "query", "{} times as fast as SciPy", (f"{scipy:.0f}",)),
        query_quote(),
    ]


def rate_quotes() -> list[Quote]:
    """Return bytes relative to the best peer, bodies in motion, and effort fast.

    Effort fast is relative to effort default.
    """
    page, rate = "docs/coding.md", stored("rate")
    peers = rate["best_peer_over_ours"]
    bound, mean = (
        [f"{value:.2g}" for value in peers[f"default, {at}, 1 frame"]] for at in ("promise", "NMSE")
    )
    fields = {speed["field"] for speed in rate["speeds"]}
    faster = [
        row(rate["speeds"], field=name, effort="fast")["encode_frames_s"]
        / row(rate["speeds"], field=name, effort="default")["encode_frames_s"]
        for name in fields
    ]
    kilobytes = rate["objects"]["file of objects, coder touch"] / 1000
    return [
        Quote(page, "rate", "needs {} to {} times the bytes of effort `default`", tuple(bound)),
        Quote(page, "rate", "it needs {} to {} times those of `default`", tuple(mean)),
        Quote(page, "rate", "take {} kilobytes", (f"{kilobytes:.0f}",)),
        Quote(
            page,
            "rate",
            "reconstruction; {} to {} times as fast",
            (f"{min(faster):.1f}", f"{max(faster):.1f}"),
        ),
    ]


def motion_quotes() -> list[Quote]:
    """Return the bytes of a ball, and the error that a hand meets on it."""
    page, ball = "docs/coding.md", row(stored("motion")["slides"], field="ball", nw=7, speed_mm_s=100.0)
    errors = f"{ball['error_mn']:.1f}", f"{ball['lattice_mn']:.1f}"
    return [
        Quote(page, "motion", "takes {} kB", (f"{ball['bytes'] / 1000:.1f}",)),
        Quote(page, "motion", "meets an error of {} mN, where the lattice itself makes {}", errors),
    ]


def fusion_quotes() -> list[Quote]:
    """Return the fraction of samples that jump when each frame is rendered alone.

    ValueError if fused frames jump, or do not take a fifth of the bytes.
    """
    rows = stored("fusion")["standing"]
    alone, fused = (row(rows, sequence="TUM fr1_rpy", world=world) for world in ("frames", "fused"))
    if fused["share"] != 0 or round(1 / fused["of_frames"]) != 5:
        raise ValueError("the docs say that fusing removes every jump and leaves a fifth of the bytes")
    percent = f"{100 * alone['share']:.0f}"
    return [Quote("docs/depth-sequences.md", "fusion", "{} % of the samples change", (percent,))]


def scaling_quotes() -> list[Quote]:
    """Return the rows of the table of exponents; one below 0 is shown as 0."""
    found = []
    for name, values in stored("scaling")["rows"].items():
        operation, what = name.split(", ")
        exponents = [f"{max(0.0, values[f'{kind}_exponent']):.2f}" for kind in ("time", "memory")]
        found.append(Quote(SCALE, "scaling", f"| {operation} | {what} | {{}} | {{}} |", tuple(exponents)))
    return found


def quotes() -> list[Quote]:
    """Return all quotes."""
    return [*speed_quotes(), *rate_quotes(), *motion_quotes(), *fusion_quotes(), *scaling_quotes()]


def text_of(page: str) -> str:
    """Return the text of a page, by its path from the root."""
    return (ROOT / page).read_text(encoding="utf-8")


def missing(page: str, text: str) -> list[Quote]:
    """Return the quotes of a page that a text does not have."""
    flat = " ".join(text.split())
    return [quote for quote in quotes() if quote.page == page and quote.text not in flat]


def written(page: str, text: str) -> str:
    """Return the text with the figures of the results in every phrase of the page.

    ValueError if a phrase is not in it.
    """
    for quote in quotes():
        if quote.page != page:
            continue
        found = quote.pattern.search(text)
        if found is None:
            raise ValueError(f"{page} has no phrase {quote.phrase!r}")
        for number in range(len(quote.figures), 0, -1):
            start, stop = found.span(number)
            text = text[:start] + quote.figures[number - 1] + text[stop:]
    return text


def main() -> None:
    pages = list(dict.fromkeys(quote.page for quote in quotes()))
    if "--write" in sys.argv[1:]:
        for page in pages:
            (ROOT / page).write_text(written(page, text_of(page)), encoding="utf-8")
    absent = [quote for page in pages for quote in missing(page, text_of(page))]
    outdated = {quote.result: quote.page for quote in quotes() if stale(quote.result)}
    for quote in quotes():
        print(f"{'MISSING' if quote in absent else 'quoted':8}{quote.page:24}{quote.result:8} {quote.text}")
    if outdated:
        print(f"stale: {', '.join(outdated)} (bench/run_all.py --stale lists the changed files)")
    sys.exit(bool(absent) or README in outdated.values())


if __name__ == "__main__":
    main()
