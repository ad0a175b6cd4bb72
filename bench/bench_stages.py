"""What each coding stage is worth: bytes at an equal error behind one and the same entropy code, and coder `touch`.

    python bench/bench_stages.py [--nw 6] [--keep FOLDER] [--data FOLDER]

First the stages of figure 4, each before the same adaptive arithmetic code (`codec.numbers`) and beside the same
coded support, on one frame: the step of each is searched for until its NMSE is that of plain quantisation by 0.05 N.
Then coder `touch` at its promise (k 0.1, F_0 0.05 N) over two frames, with one switch turned at a time, at efforts
default and strongest; and fields decoded from coder `paper`, kept exactly: mode "lossless" against zstd -19 (where it
is installed) and xz of the same forces, component by component. Fields are those of `rate.py`.
"""

from __future__ import annotations

import argparse
import lzma
import math
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from time import perf_counter
from typing import Any

from machine import keep
from rate_fields import SHARED, cases
from rate_ours import EFFORTS as ALL_EFFORTS
from rate_ours import Search, TouchSpec, touch
from touchfield.codec.field_stage import FieldStage, PlainStage, RunStage, decode_field, encode_field
from touchfield.codec.paper import PaperDecoder, PaperEncoder
from touchfield.codec.paper_spec import PaperSpec
from touchfield.codec.predictive import AdpcmSpec, DpcmSpec
from touchfield.codec.spectral import DctSpec, WaveletSpec
from touchfield.codec.touch.palette_model import PaletteModel
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField

STEP_N = 0.05
NAMES = ("tum band", "icl height", "motorcycle band", "terrain height", "falling")
FRAMES = 2
EFFORTS = ("default", ALL_EFFORTS[-1])
TRIALS = 9

Maker = Callable[[ForceField, float], FieldStage]

STAGES: dict[str, Maker] = {
    "plain": lambda _, step: PlainStage(step),
    "run-length": lambda _, step: RunStage(step),
    "DPCM": lambda field, step: DpcmSpec(step).fit(field),
    "ADPCM": lambda field, step: AdpcmSpec(step).fit(field),
    "wavelet 5/3": lambda field, step: WaveletSpec(step).fit(field),
    "DCT": lambda field, step: DctSpec(step).fit(field),
}

SWITCHES: dict[str, dict[str, Any]] = {
    "touch": {},
    "no inter frames": {"interframe": "off"},
    "no motion": {"motion": "off"},
    "motion": {"motion": "on"},
    "no surface": {"surface": "off"},
    "surface": {"surface": "on"},
    "exact support": {"support": "exact"},
}


def measured(stage: FieldStage, field: ForceField) -> tuple[int, float]:
    """Bytes, and NMSE in dB."""
    data = encode_field(stage, field)
    meter = FidelityMeter(0.1, 0.05)
    meter.add(field, decode_field(data, field.grid))
    return len(data), meter.nmse_db if meter.nmse_db is not None else -math.inf


def at_equal_error(make: Maker, field: ForceField, wanted_db: float) -> dict[str, float]:
    """Bytes of a stage at the NMSE, between the trials of its step that are nearest to it."""

    def code(step: float) -> tuple[float, float]:
        size, nmse_db = measured(make(field, step), field)
        return nmse_db, size

    search = Search(code, wanted_db, STEP_N, trials=TRIALS).run()
    return {"bytes": search.size(), "step_n": search.step(), "nmse_db": wanted_db, "trials": len(search.tried)}


def stage_rows(field: ForceField) -> dict[str, dict[str, float]]:
    """Every stage on one frame."""
    size, nmse_db = measured(PlainStage(STEP_N), field)
    rows = {"plain": {"bytes": size, "step_n": STEP_N, "nmse_db": nmse_db}}
    for name, make in STAGES.items():
        if name not in rows:
            rows[name] = at_equal_error(make, field, nmse_db)
    return rows


def switch_rows(frames: list[ForceField], effort: str) -> dict[str, dict[str, float]]:
    """Coder `touch` with one switch turned at a time."""
    rows = {}
    for name, asked in SWITCHES.items():
        if not set(asked) <= {one.name for one in fields(TouchSpec)}:
            continue  # a switch that this coder does not have
        coded = touch(frames, effort=effort, **asked)
        rows[name] = {"bytes": coded.bytes, "nmse_db": coded.nmse_db, "beyond": coded.beyond}
    return rows


def lossless_row(field: ForceField) -> dict[str, float]:
    """A field that coder `paper` decoded, exactly."""
    encoder = PaperEncoder(field.grid, PaperSpec(nq=6, directions="octa3", deadband="none"))
    body = encoder.encode_segment([field]).body
    (decoded,) = PaperDecoder(field.grid, encoder.parameters).frames(body, 1)
    planes = decoded.vectors_n().T.tobytes()
    began = perf_counter()
    payload, _ = PaletteModel().encode(decoded)
    row = {"paper": len(body), "lossless": len(payload), "encode_ms": 1e3 * (perf_counter() - began)}
    began = perf_counter()
    assert PaletteModel().decode(payload, field.grid) == decoded
    row |= {"decode_ms": 1e3 * (perf_counter() - began), "xz": len(lzma.compress(planes, preset=9))}
    if zstd := shutil.which("zstd"):
        row["zstd -19"] = len(
            subprocess.run([zstd, "-19", "-c"], input=planes, capture_output=True, check=True).stdout
        )
    return row


def show(title: str, rows: dict[str, dict[str, float]], first: str) -> None:
    """Bytes, and how many times those of the row `first`."""
    base = rows[first]["bytes"]
    line = ", ".join(f"{name} {row['bytes']:,.0f} ({row['bytes'] / base:.2f})" for name, row in rows.items())
    print(f"{title}: {line}", flush=True)


def main() -> None:
    """Print and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nw", type=int, nargs="+", default=[6])
    parser.add_argument("--keep", type=Path, help="a folder of fields, made by an earlier run or to be")
    parser.add_argument(
        "--data", type=Path, default=SHARED, help="the optional real inputs, by default ../shared/data"
    )
    asked, results = parser.parse_args(), {}
    began = perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        for case in cases(tuple(asked.nw), NAMES, asked.data):
            frames = case.frames(asked.keep or Path(scratch))[:FRAMES]
            stages, lossless = stage_rows(frames[0]), lossless_row(frames[0])
            show(f"{case.title}, stages at {stages['plain']['nmse_db']:.1f} dB", stages, "plain")
            told = ", ".join(f"{name} {value:,.0f}" for name, value in lossless.items())
            print(f"{case.title}, lossless: {told}", flush=True)
            switches = {}
            for effort in EFFORTS:
                switches[effort] = switch_rows(frames, effort)
                show(f"{case.title}, touch {effort}, {len(frames)} frames", switches[effort], "touch")
            results[case.title] = {"stages": stages, "touch": switches, "lossless": lossless}
            print(f"[{perf_counter() - began:.0f} s]", file=sys.stderr, flush=True)
    keep("stages", {"step_n": STEP_N, "frames": FRAMES, "fields": results, "seconds": perf_counter() - began})


if __name__ == "__main__":
    main()
