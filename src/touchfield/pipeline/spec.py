"""Everything asked of the main job, and how it travels in a stream's provenance."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import coder as coder_entry
from touchfield.codec.registry import field_coders
from touchfield.codec.segment import longest_segment, segment_length
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import (
    CorruptFile,
    InvalidArgument,
    require_kinds,
    require_not_negative,
    require_one_of,
    require_positive,
)
from touchfield.files import json_of
from touchfield.filters.contact import VibrationRule
from touchfield.filters.device_filter import DeviceFilterSpec, require_nw
from touchfield.filters.registry import FieldFilter, field_filters, filter_of
from touchfield.options import option
from touchfield.perception.human import figure
from touchfield.sources.laws import LawSpec
from touchfield.sources.options import SourceOptions

CODERS: Final = tuple(field_coders())  # of fields, those of plug-ins last; the first is the default
BUILT_IN_CODERS: Final = ("touch", "paper")
DEFAULT_F0_N = figure("force_threshold_n")
"""F_0, the absolute force threshold of the mask of coder `paper`, newtons; its source is in
perception/human.toml.
"""

Frames = tuple[int, int | None]
"""The first of some frames, and the one behind the last; None: the end."""

REPRESENTATIONS: Final = ("auto", "voxel", "object")
COEFFICIENTS: Final = ("friction", "damping_n_s_per_m")
_OPTIONAL: Final = ("vibration", "fit_frames", *COEFFICIENTS)
NO_FLOOR_N: Final = 1e-30  # in place of F_0 = 0 where a measure takes none: less than any force
OWN_FORCES: Final = "the source's own forces, sample by sample"
"""Likewise where the source is a stored field on the lattice of the file, and no haptic filter is asked for.

"""


def require_frames(where: str, frames: Any) -> None:
    """`InvalidArgument` for what are no `Frames`, and not None."""
    try:
        start, stop = frames or (0, None)
        is_range = start >= 0 and (stop is None or start < stop)
    except (TypeError, ValueError):
        is_range = False
    if not is_range:
        raise InvalidArgument(where, repr(frames), "START below STOP, neither negative")


def _asked(spec: Any) -> dict[str, Any]:
    """The fields of a spec that are not as by default."""
    usual, every = type(spec)(), ((one.name, getattr(spec, one.name)) for one in fields(spec))
    return {name: value for name, value in every if value != getattr(usual, name)}


@dataclass(frozen=True)
class EncodeSpec:
    """Everything asked of the main job.

    Lengths and stiffness are in the metres that the hand moves. `nw` None means the device's nominal lattice;
    `representation` "auto" is "object" where the scene is of rigid bodies that move and the device is a
    point; `mapping` "fill" leaves no margin; `coder` is one of `CODERS`, and `touch` or `paper` what is asked
    of it; `filters` are the haptic filters that follow the device filter, each its name and its words
    (`touchfield.filters.registry`); `vibration` (`touchfield.filters.contact`) takes the voxel
    representation; `friction` and `damping_n_s_per_m` are mu and b of paper 3.2.
    InvalidArgument if there is no such coder, or something is asked of the coder that is not taken.
    """

    device: str = option(
        "phantom-omni", "Device profile (see `touchfield devices`), or a TOML file of your own."
    )
    nw: int | None = option(7, "2^nw samples per axis of the device's workspace, 3 to 10.")
    frames: Frames | None = option(
        None, "Frames to take, START:STOP; also those that are fitted into the workspace."
    )
    fit_frames: Frames | None = option(
        None, "Frames to fit into the workspace, START:STOP, if others than --frames."
    )
    law: str = option(
        "penalty", "Force law: penalty, proximity, magnetic, or a sum such as penalty+proximity."
    )
    stiffness_n_per_m: float = option(500.0, "Stiffness K, newtons per metre that the hand moves.")
    thickness_m: float | None = option(
        None, "Wall behind the surface, metres that the hand moves; inf is solid."
    )
    band_m: float = option(0.004, "Reach of the proximity and magnetic laws, metres that the hand moves.")
    surface_damping_n_s_per_m: float = option(0.0, "Drag of a moving surface: b times its velocity is added.")
    representation: str = option("auto", "voxel, object (fields and pose tracks), or auto.")
    mapping: str | float = option(
        "fit", "Scene to workspace: fit (5 % room is left), fill, crop, or a factor such as 0.05."
    )
    oversample: int = option(2, "Samples per axis and device sample before the anti-alias low-pass.")
    pool: str = option(
        "auto", "Depth of an array: max, mean, relief (heights, from above), or auto: what suits it."
    )
    cutoff: str = option("nyquist", "Low-pass of an actuator array: nyquist = 1/(2d), or literal = 2/d.")
    source: SourceOptions = field(default_factory=SourceOptions)
    coder: str = CODERS[0]
    touch: TouchSpec = field(default_factory=TouchSpec)
    paper: PaperSpec = field(default_factory=PaperSpec)
    extension: Any = None  # the spec of a coder that a plug-in provides
    filters: tuple[tuple[str, str], ...] = ()
    vibration: str | None = option(
        None, "Beside the force: gain=0.1,frequency=150, or rising: frequency=80..250."
    )
    friction: float | None = option(None, "Friction mu, which the receiver renders; default: the source's.")
    damping_n_s_per_m: float | None = option(
        None, "Damping b, which the receiver renders; default: the source's."
    )

    def __post_init__(self) -> None:
        require_kinds(self, representation=REPRESENTATIONS, coder=CODERS)
        for name in (*COEFFICIENTS, "surface_damping_n_s_per_m"):
            value = getattr(self, name)
            if value is not None:
                require_not_negative(**{name: value})
        for name in ("frames", "fit_frames"):
            require_frames(name, getattr(self, name))
        require_nw(self.nw)
        is_list = isinstance(self.filters, tuple | list)
        if not (is_list and all(isinstance(one, tuple | list) and len(one) == 2 for one in self.filters)):
            raise InvalidArgument(
                "filters", repr(self.filters), 'names and words, such as (("gaussian", "2mm"),)'
            )
        for name, _ in self.filters:  # not the words: those of a stranger's stream may name a file
            require_one_of("filters", name, field_filters())
        _ = self.factor, self.device_filter, self.law_spec(1.0)  # each says what cannot be
        if self.vibration is not None:
            VibrationRule.parse(self.vibration)
            if self.representation == "object":
                said = "--vibration works with --representation voxel or auto, not with object"
                raise InvalidArgument(f"{said}: objects have no samples that could vibrate, so take voxel")
        self._require_spec_of_coder()

    def _require_spec_of_coder(self) -> None:
        """InvalidArgument if a plug-in's coder has no spec, or something is asked of a coder that is not
        taken.
        """
        expected = field_coders()[self.coder].spec
        if not isinstance(self.coding, expected or object):
            where = self.coder if self.coder in BUILT_IN_CODERS else "extension"
            raise InvalidArgument(where, repr(self.coding), f"a {getattr(expected, '__name__', expected)}")
        for other in BUILT_IN_CODERS:
            stray = _asked(getattr(self, other)) if other != self.coder else {}
            for name, value in stray.items():
                raise InvalidArgument(f"{name} {value!r} works with coder {other}, not with {self.coder}")

    @property
    def coding(self) -> Any:
        """The spec of the coder that is taken."""
        return getattr(self, self.coder) if self.coder in BUILT_IN_CODERS else self.extension

    @property
    def k(self) -> float:
        """The Weber fraction of the coder that is taken."""
        return float(self.coding.k)

    @property
    def f0_n(self) -> float:
        """F_0 of the mask, newtons: what the coder is asked to keep, or, where it keeps none, what a hand
        feels.
        """
        return float(getattr(self.coding, "f0_n", DEFAULT_F0_N))

    def segment_frames_at(self, rate_hz: float) -> int:
        """Frames in an independent segment of a medium of that rate."""
        return segment_length(self.coding.segment_frames, rate_hz)

    def longest_segment_at(self, rate_hz: float) -> int:
        """Frames of a segment at most, where frames that are the one before again do not count."""
        return longest_segment(self.coding.segment_frames, rate_hz)

    @property
    def factor(self) -> float | None:
        """Metres of the hand for one of the scene; None where the scene is fitted into the workspace."""
        if self.mapping in ("fit", "fill"):
            return None
        try:
            factor = 1.0 if self.mapping == "crop" else float(self.mapping)
        except (TypeError, ValueError):
            expected = "fit, fill, crop, or a factor such as 0.05"
            raise InvalidArgument("mapping", repr(self.mapping), expected) from None
        require_positive(mapping=factor)
        return factor

    def law_spec(self, force_max_n: float) -> LawSpec:
        """The force law that is asked for, of a device with this F_max."""
        damping = self.surface_damping_n_s_per_m
        return LawSpec(self.law, self.stiffness_n_per_m, force_max_n, self.thickness_m, self.band_m, damping)

    @property
    def chain(self) -> tuple[FieldFilter, ...]:
        """The haptic filters asked for."""
        return tuple(filter_of(name, words) for name, words in self.filters)

    @property
    def device_filter(self) -> DeviceFilterSpec:
        """The spec of the device filter."""
        return DeviceFilterSpec(oversample=self.oversample, pool=self.pool, cutoff=self.cutoff)

    def to_json(self, has_law: bool = True) -> str:
        """The spec as the stream's provenance keeps it, without what is asked of a coder that is not taken.

        Without `has_law` it states no law and no stiffness: a receiver would make walls of it.
        """
        values = {**asdict(self), "thickness_m": str(self.thickness_m) if self.thickness_m else None}
        values[self.coder] = asdict(self.coding)
        unused = () if has_law else ("law", "stiffness_n_per_m")
        other_coders = (name for name in BUILT_IN_CODERS if name != self.coder)
        for name in (*other_coders, "extension", *(n for n in _OPTIONAL if values[n] is None), *unused):
            del values[name]
        del values["source"]["allow_outside"]  # the user's alone, each time
        return json.dumps(values, separators=(",", ":"))

    def asked(self) -> dict[str, Any]:
        """All that differs from the defaults, by the names of the options."""
        inner = "source", *BUILT_IN_CODERS
        own = {name: value for name, value in _asked(self).items() if name not in (*inner, "extension")}
        specs = [getattr(self, name) for name in inner] + [self.extension] * (self.extension is not None)
        return own | {name: value for spec in specs for name, value in _asked(spec).items()}

    @classmethod
    def from_json(cls, text: str) -> EncodeSpec:
        """The spec of a stream, so that its source can be filtered again in the same way.

        CorruptFile if the provenance cannot be understood.
        """
        try:
            values = json_of(text)
            values["source"] = SourceOptions(**{**values["source"], "allow_outside": False})
            coder = values["coder"]
            spec = coder_entry(coder, "PROV spec").spec
            if spec is None:
                raise ValueError(f"coder {coder!r} codes no fields")
            coding = spec(**values.pop(coder))
            values[coder if coder in BUILT_IN_CODERS else "extension"] = coding
            if values["thickness_m"] is not None:
                values["thickness_m"] = float(values["thickness_m"])
            for name in ("frames", "fit_frames"):
                if values.get(name) is not None:
                    values[name] = tuple(values[name])
            values["filters"] = tuple((str(name), str(words)) for name, words in values.get("filters", ()))
            return cls(**values)
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            raise CorruptFile(
                "PROV spec", f"a spec that cannot be read ({error})", "what encode wrote"
            ) from None


@dataclass(frozen=True)
class ReductionSpec:
    """Wishes of `touchfield.tasks.reduction.reduce_medium`: its modes, and the hand.

    By default the hand pushes with the continuous force of `device`, has its mass with a light hand's, and
    0.2 m/s.
    """

    modes: str = option("global", "global: of whole frames; bricks: of bricks of 8^3 samples.")
    rank: int | None = option(None, "Modes to keep; default: as many as --nmse-db needs.")
    nmse_db: float = option(-30.0, "Error that modes are counted for.")
    push_n: float | None = option(None, "Of the hand, at most; default: the device's.")
    mass_kg: float | None = option(None, "Of hand and device; default: 50 g and its own.")
    speed_m_s: float | None = option(None, "Of the hand, at most; default: 0.2.")
    device: str | None = option(None, "Device in the hand; default: that of MEDIUM.")
    trace: Path | None = option(None, "Where a hand was: t_s,x_m,y_m,z_m, as a play's --log.")

    def __post_init__(self) -> None:
        require_kinds(self)
        if not -200 <= self.nmse_db < 0:
            raise InvalidArgument("nmse_db", repr(self.nmse_db), "decibels below 0, such as -30")


@dataclass(frozen=True)
class Motion:
    """Frames of an animated model that become tracks, first and behind the last, and the one that a stream
    shows.
    """

    model: str | Path
    animation: str | None = option(None, "Name or number of MODEL's animation; default: the first.")
    frames: Frames | None = option(None, "Frames of the animation to take, START:STOP.")
    rest_frame: int | None = option(
        None, "Frame of MODEL that STREAM shows; default: the first that is taken."
    )
    rate_hz: float = option(60.0, "Frames a second of the tracks.")

    def __post_init__(self) -> None:
        require_kinds(self)
        require_frames("frames", self.frames)
