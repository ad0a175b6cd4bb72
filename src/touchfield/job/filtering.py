"""The effect of each haptic filter of a chain on a medium: information, energy, and what a hand feels (paper 3.2).

"Convolving its impulse response with x would result in a filtered version with much lower entropy": per sample that
is not always so (a blur makes new values), which is why the bits of a whole frame stand beside those of a voxel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import limited
from touchfield.filters.registry import FieldFilter
from touchfield.job.objects import felt_objects
from touchfield.job.prepare import Prepared, prepare
from touchfield.job.spec import DEFAULT_F0_N, EncodeSpec
from touchfield.measure.counts import SymbolCounter
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField
from touchfield.parallel import Report, silent
from touchfield.sources.scene import Scene


@dataclass(frozen=True)
class FilterReport:
    """The medium before the chain and after each filter of it; `quantiser` is the Q of the entropies.

    Each of `stages` tells its name, support, greatest and root-mean-square force, entropies, and what changed against
    the medium before the chain: NMSE in dB, and the share of voxels beyond the mask.
    """

    quantiser: str
    stages: tuple[dict[str, Any], ...]

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {"quantiser": self.quantiser, "stages": list(self.stages)}


def filter_report(
    source: str | Path | Scene,
    spec: EncodeSpec,
    quantiser: FieldQuantiserSpec | None = None,
    report: Report = silent,
) -> FilterReport:
    """Measure a medium before and after each filter of ``spec.filters``, frame by frame.

    ``spec.paper.k`` is the Weber fraction of the mask; `quantiser`, the Q of the entropies, is by default fitted to
    the device's F_max and kept for all stages.
    """
    prepared = prepare(source, replace(spec, filters=()))
    medium = prepared.medium
    asked = quantiser or FieldQuantiserSpec()
    if asked.form == "distinct":
        raise InvalidArgument(
            "quantiser of the report", "distinct", "one that also knows filtered forces, such as weber:0.1"
        )
    quantise = asked.fit(medium, prepared.device.force_max_n)
    chain, stages_of = spec.chain, _stages(prepared, spec.chain)
    gauges = [_Gauge("device filter", spec)] + [_Gauge(step.name, spec) for step in chain]
    for i in range(len(medium)):
        stages = stages_of(i)
        for gauge, field in zip(gauges, stages, strict=True):
            gauge.add(stages[0], field, quantise(field).object_symbols)
        report(i + 1, len(medium))
    return FilterReport(quantise.words, tuple(gauge.row() for gauge in gauges))


def _stages(prepared: Prepared, chain: tuple[FieldFilter, ...]) -> Callable[[int], list[ForceField]]:
    """A frame as the device would render it, and after each filter; of objects, each filtered alone."""
    force_max_n, medium, scene = prepared.device.force_max_n, prepared.medium, prepared.scene
    if scene is not None:
        media = [felt_objects(scene, chain[:n]).voxelise() for n in range(len(chain) + 1)]
        return lambda i: [one[i] for one in media]

    def of_voxels(i: int) -> list[ForceField]:
        field = medium[i]
        stages = [limited(field, force_max_n)]
        for step in chain:
            field = step(field)
            stages.append(limited(field, force_max_n))
        return stages

    return of_voxels


def draw_filtered(source: str | Path | Scene, spec: EncodeSpec, path: str | Path) -> None:
    """Write the picture of the middle frame before and after the chain of ``spec.filters``, PNG.

    MissingExtra if matplotlib is not installed.
    """
    from touchfield.viewer.picture import PictureSpec, draw_comparison

    before = prepare(source, replace(spec, filters=()))
    middle = len(before.medium) // 2
    stages = _stages(before, spec.chain)(middle)
    x, y = stages[0], stages[-1]
    meter = FidelityMeter(spec.paper.k, DEFAULT_F0_N)
    meter.add(x, y)
    chain = ", ".join(step.name for step in spec.chain)
    title = f"frame {middle + 1} of {len(before.medium)} for {before.device.name}, before and after {chain}"
    changed = f"{100 * meter.mask_violation_share:.1f} % of voxels changed by more than a hand can feel"
    view = PictureSpec(title, changed, before.medium.axes, meter.k, meter.f0_n, ("before", "after"))
    draw_comparison(Path(path), x, y, view)


class _Gauge:
    """Adds up one stage over the frames."""

    def __init__(self, name: str, spec: EncodeSpec) -> None:
        self.name = name
        self.meter = FidelityMeter(spec.paper.k, DEFAULT_F0_N)
        self.counter = SymbolCounter()
        self.frames = self.support = 0
        self.voxels = 0
        self.energy, self.top_n = 0.0, 0.0

    def add(self, before: ForceField, field: ForceField, symbols: Any) -> None:
        self.meter.add(before, field)
        self.counter.add(symbols, field.grid.voxel_count)
        squares = np.einsum("...c,...c->...", field.forces_n, field.forces_n, dtype=np.float64)
        self.energy += float(squares.sum())
        self.top_n = max(self.top_n, float(np.sqrt(squares.max(initial=0.0))))
        self.support += field.support_count
        self.voxels = field.grid.voxel_count
        self.frames += 1

    def row(self) -> dict[str, Any]:
        bits = self.counter.voxel_bits
        return {
            "stage": self.name,
            "supported_voxels": self.support,
            "rms_n": float(np.sqrt(self.energy / max(1, self.support))),
            "greatest_n": self.top_n,
            "entropy_voxel_bits": bits,
            "entropy_object_bits": self.counter.object_bits,
            "entropy_bits_per_frame": bits * self.voxels,
            "nmse_db": self.meter.nmse_db,
            "mask_violation_share": self.meter.mask_violation_share,
        }
