"""The figures that README quotes: each a phrase, and where its numbers come from in the results.

    python bench/readme.py [--write]

Lists the quoted phrases, those that README does not have, and the results that are stale. `--write` puts the figures
of the results into README. Speeds are quoted as ratios to a peer of the same run: machines change from day to day.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any, NamedTuple

from machine import stale, stored

README = Path(__file__).resolve().parents[1] / "README.md"


class Quote(NamedTuple):
    """A phrase of README with {} for each figure, the figures as text, and the result that they are of."""

    result: str
    phrase: str
    figures: tuple[str, ...]

    @property
    def text(self) -> str:
        """The phrase with its figures."""
        return self.phrase.format(*self.figures)

    @property
    def pattern(self) -> re.Pattern[str]:
        """The phrase with any figures, over the ends of lines."""
        parts = [re.sub(r"(?:\\ |\\\n)+", r"\\s+", re.escape(part)) for part in self.phrase.split("{}")]
        return re.compile(r"(\d[\d.,]*\d|\d)".join(parts))


def row(rows: list[dict[str, Any]], **wanted: Any) -> dict[str, Any]:
    """The one row with these values."""
    (one,) = (r for r in rows if all(r[key] == value for key, value in wanted.items()))
    return one


def rate_quotes() -> list[Quote]:
    """Bytes beside those of the best peer, bodies in motion, and effort fast beside default."""
    rate = stored("rate")
    peers = rate["best_peer_over_ours"]
    bound, mean = ([f"{value:.2g}" for value in peers[f"default, {at}, 1 frame"]] for at in ("promise", "NMSE"))
    fields = {one["field"] for one in rate["speeds"]}
    faster = [
        row(rate["speeds"], field=name, effort="fast")["encode_frames_s"]
        / row(rate["speeds"], field=name, effort="default")["encode_frames_s"]
        for name in fields
    ]
    kilobytes = rate["objects"]["file of objects, coder touch"] / 1000
    return [
        Quote("rate", "needs {} to {} times the bytes of effort `default`", tuple(bound)),
        Quote("rate", "it needs {} to {} times those of `default`", tuple(mean)),
        Quote("rate", "take {} kilobytes", (f"{kilobytes:.0f}",)),
        Quote("rate", "codes {} to {} times as quickly", (f"{min(faster):.1f}", f"{max(faster):.1f}")),
    ]


def motion_quotes() -> list[Quote]:
    """A ball: its bytes, and the error that a hand meets that slides over it."""
    ball = row(stored("motion")["slides"], field="ball", nw=7, speed_mm_s=100.0)
    errors = f"{ball['error_mn']:.1f}", f"{ball['lattice_mn']:.1f}"
    return [
        Quote("motion", "takes {} kB", (f"{ball['bytes'] / 1000:.1f}",)),
        Quote("motion", "meets an error of {} mN, where the lattice itself makes {}", errors),
    ]


def fusion_quotes() -> list[Quote]:
    """Samples that jump between frames felt alone; fused none do, and a fifth of the bytes are left."""
    rows = stored("fusion")["standing"]
    alone, fused = (row(rows, sequence="TUM fr1_rpy", world=world) for world in ("frames", "fused"))
    if fused["share"] != 0 or round(1 / fused["of_frames"]) != 5:
        raise ValueError("README says of fused frames that no sample jumps and a fifth of the bytes is left")
    return [Quote("fusion", "{} % of the samples change", (f"{100 * alone['share']:.0f}",))]


def speed_quotes() -> list[Quote]:
    """Times of peers over ours, and of a first job over a second."""
    depth, mesh, query, c = (stored(name) for name in ("depth", "mesh", "query", "c"))
    peers = [f"{depth['128^3'][name]['ratio']:.0f}" for name in ("numpy", "warp")]
    fastest = min(one["times_touchfield"] for one in mesh["rows"].values() if "version" in one)
    startup = stored("startup")
    again = startup["first_encode_s"] / startup["second_encode_s"]
    cold = c["cold_decode_without_s"] / c["cold_decode_s"]
    return [
        Quote("depth", "{} times as fast as with numpy and {} times as fast as with NVIDIA Warp", tuple(peers)),
        Quote("mesh", "a mesh {} times as fast as with the fastest", (f"{fastest:.1f}",)),
        Quote("query", "{} times as fast as by SciPy", (f"{query['batches']['path']['times']:.0f}",)),
        Quote("c", "one thread {} times as fast as the compiled Python", (f"{c['decode_times_numba']:.1f}",)),
        Quote("c", "the first `touchfield decode` is {} times as fast", (f"{cold:.0f}",)),
        Quote("startup", "it takes {} times as long as those that follow", (f"{again:.0f}",)),
    ]


def quotes() -> list[Quote]:
    """All of them."""
    return [*rate_quotes(), *motion_quotes(), *fusion_quotes(), *speed_quotes()]


def missing(text: str) -> list[Quote]:
    """Those that a text does not have."""
    flat = " ".join(text.split())
    return [quote for quote in quotes() if quote.text not in flat]


def written(text: str) -> str:
    """The text with the figures of the results in every phrase; ValueError if a phrase is not in it."""
    for quote in quotes():
        found = quote.pattern.search(text)
        if found is None:
            raise ValueError(f"README has no phrase {quote.phrase!r}")
        for number in range(len(quote.figures), 0, -1):
            start, stop = found.span(number)
            text = text[:start] + quote.figures[number - 1] + text[stop:]
    return text


def main() -> None:
    text = README.read_text(encoding="utf-8")
    if "--write" in sys.argv[1:]:
        text = written(text)
        README.write_text(text, encoding="utf-8")
    absent, old = missing(text), {}
    for quote in quotes():
        old[quote.result] = stale(quote.result)
        print(f"{'MISSING' if quote in absent else 'quoted':8}{quote.result:8} {quote.text}")
    outdated = [name for name, files in old.items() if files]
    if outdated:
        print(f"stale: {', '.join(outdated)} (bench/run_all.py --stale says why)")
    sys.exit(bool(absent or outdated))


if __name__ == "__main__":
    main()
