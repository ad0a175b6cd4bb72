"""What is asked of the main job, and how it travels in a stream's provenance."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from touchfield.codec.paper_spec import PaperSpec
from touchfield.errors import CorruptFile
from touchfield.filters.device_filter import DeviceFilterSpec
from touchfield.filters.field_filter import FieldFilter
from touchfield.filters.registry import filter_of
from touchfield.perception.human import figure
from touchfield.sources.options import SourceOptions

__all__ = ["DEFAULT_F0_N", "EncodeSpec", "Report", "silent"]

Report = Callable[[int, int], None]
"""``report(done, total)``: how far a long job has come."""

DEFAULT_F0_N = figure("force_threshold_n")
"""F_0, the absolute force threshold of the mask, newtons; its source is in perception/human.toml."""


def silent(done: int, total: int) -> None:
    """A `Report` that says nothing."""


@dataclass(frozen=True)
class EncodeSpec:
    """What was asked of the main job; see the command line's help for each.

    Lengths and stiffness are in the metres that the hand moves. `nw` None means the device's nominal lattice;
    `representation` is "voxel", "object", or "auto" (object where the scene is of rigid bodies that move and the
    device is a point); `frames` is (start, stop), stop None meaning the end; `mapping` is "fit", "crop" or a factor;
    `filters` are the haptic filters that follow the device filter, each its name and its words
    (`touchfield.filters.registry`).
    """

    device: str = "phantom-omni"
    nw: int | None = 7
    frames: tuple[int, int | None] | None = None
    law: str = "penalty"
    stiffness_n_per_m: float = 500.0
    thickness_m: float | None = None
    band_m: float = 0.004
    surface_damping_n_s_per_m: float = 0.0
    representation: str = "auto"
    mapping: str = "fit"
    oversample: int = 2
    pool: str = "max"
    cutoff: str = "nyquist"
    source: SourceOptions = field(default_factory=SourceOptions)
    paper: PaperSpec = field(default_factory=PaperSpec)
    filters: tuple[tuple[str, str], ...] = ()

    @property
    def chain(self) -> tuple[FieldFilter, ...]:
        """The haptic filters asked for."""
        return tuple(filter_of(name, words) for name, words in self.filters)

    @property
    def device_filter(self) -> DeviceFilterSpec:
        """What is asked of the device filter."""
        return DeviceFilterSpec(oversample=self.oversample, pool=self.pool, cutoff=self.cutoff)

    def to_json(self) -> str:
        """The spec as the stream's provenance keeps it."""
        return json.dumps({**asdict(self), "thickness_m": str(self.thickness_m) if self.thickness_m else None})

    def asked(self) -> dict[str, Any]:
        """What differs from the defaults, by the names of the options."""
        told: dict[str, Any] = {}
        for mine, usual in ((self, EncodeSpec()), (self.source, SourceOptions()), (self.paper, PaperSpec())):
            told |= {
                f.name: getattr(mine, f.name)
                for f in fields(mine)
                if f.name not in ("source", "paper") and getattr(mine, f.name) != getattr(usual, f.name)
            }
        return told

    @classmethod
    def from_json(cls, text: str) -> EncodeSpec:
        """The spec of a stream, so that its source can be filtered again in the same way.

        Raises
        ------
        CorruptFile
            If the provenance cannot be understood.
        """
        try:
            values = json.loads(text)
            values["source"] = SourceOptions(**values["source"])
            values["paper"] = PaperSpec(**values["paper"])
            if values["thickness_m"] is not None:
                values["thickness_m"] = float(values["thickness_m"])
            if values["frames"] is not None:
                values["frames"] = tuple(values["frames"])
            values["filters"] = tuple((str(name), str(words)) for name, words in values.get("filters", ()))
            return cls(**values)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise CorruptFile("PROV spec", f"a spec that cannot be read ({error})", "what encode wrote") from None
