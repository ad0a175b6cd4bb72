"""`EncodeSpec`: all options of an encoding, checked, and their JSON form, which a ``.touch`` file stores."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import coder as coder_entry, field_coders
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
from touchfield.filters.device_spec import DeviceFilterSpec, require_nw
from touchfield.filters.registry import FieldFilter, field_filters, filter_of
from touchfield.options import option
from touchfield.perception.human import figure
from touchfield.perception.mask import Weber
from touchfield.sources.laws import LawSpec
from touchfield.sources.options import SourceOptions

CODERS: Final = tuple(field_coders())  # coders of fields; the first is the default, plug-ins come last
BUILT_IN_CODERS: Final = ("touch", "paper")
DEFAULT_F0_N = figure("force_threshold_n")
"""F_0 in newtons, the absolute force threshold of the mask of coder `paper` (perception/human.toml)."""

Frames = tuple[int, int | None]
"""Start and stop of a range of frames; stop None is the end."""

REPRESENTATIONS: Final = ("auto", "voxel", "object")
THIN: Final = ("thicken", "keep")
COEFFICIENTS: Final = ("friction", "damping_n_s_per_m")
_OPTIONAL_OF_SOURCE: Final = {"pose_form": None, "depth_encoding": None, "topic": None, "normals": "auto"}
"""Options of a source that are left out at these values, so that files from before them keep their bytes."""
_OPTIONAL: Final = ("vibration", "fit_frames", *COEFFICIENTS)
NO_FLOOR_N: Final = 1e-30  # for a measure that needs F_0 above 0: smaller than any force
SOURCE_FORCES: Final = "the source's own forces, sample by sample"
"""The field that an error bound refers to, if the source is a stored field on the lattice of the file.

No haptic filter is then applied; for any other source it is `touchfield.pipeline.stream.FILTERED`.
"""


def spec_field(coder: str) -> str:
    """Name of the field of `EncodeSpec` for the spec of a coder: a built-in coder's own, else "extension"."""
    return coder if coder in BUILT_IN_CODERS else "extension"


def require_frames(where: str, frames: Any) -> None:
    """`InvalidArgument` unless `frames` are `Frames` or None."""
    try:
        start, stop = frames or (0, None)
        is_range = start >= 0 and (stop is None or start < stop)
    except (TypeError, ValueError):
        is_range = False
    if not is_range:
        raise InvalidArgument(where, repr(frames), "START below STOP, neither negative")


def _changed_fields(spec: Any) -> dict[str, Any]:
    """The fields of a spec that differ from their defaults."""
    defaults = type(spec)()
    names = [item.name for item in fields(spec)]
    return {name: getattr(spec, name) for name in names if getattr(spec, name) != getattr(defaults, name)}


@dataclass(frozen=True)
class EncodeSpec:
    """Options of the pipeline.

    Lengths and stiffness are in metres of the hand. `nw` None is the device's nominal lattice.
    `representation` "auto" is "object" for moving rigid bodies on a point device, else "voxel". `mapping`
    "fill" leaves no margin. `coder` is one of `CODERS`, and `touch` or `paper` has its options. `filters` are
    the haptic filters after the device filter, each a name and its arguments
    (`touchfield.filters.registry`). `vibration` (`touchfield.filters.contact`) needs the voxel
    representation. `friction` and `damping_n_s_per_m` are mu and b of paper 3.2.

    InvalidArgument if there is no such coder, or an option belongs to a coder that is not used.
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
    thin: str = option(
        "thicken", "Walls too thin for the lattice: thicken, or keep (the hand may pass through)."
    )
    band_m: float = option(0.004, "Reach of the proximity and magnetic laws, metres that the hand moves.")
    surface_damping_n_s_per_m: float = option(0.0, "Drag of a moving surface: b times its velocity is added.")
    representation: str = option("auto", "voxel, object (fields and pose tracks), or auto.")
    mapping: str | float = option(
        "fit", "Scene to workspace: fit (leaves a margin of 5 %), fill, crop, or a factor such as 0.05."
    )
    oversample: int = option(2, "Samples per axis and device sample before the anti-alias low-pass.")
    pool: str = option(
        "auto", "Depth of an array: max, mean, relief (heights, from above), or auto: by the device."
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
    allow_empty: bool = option(False, "Write a result in which nothing can be felt; otherwise an error.")

    def __post_init__(self) -> None:
        require_kinds(self, representation=REPRESENTATIONS, thin=THIN, coder=CODERS)
        for name in (*COEFFICIENTS, "surface_damping_n_s_per_m"):
            value = getattr(self, name)
            if value is not None:
                require_not_negative(**{name: value})
        for name in ("frames", "fit_frames"):
            require_frames(name, getattr(self, name))
        require_nw(self.nw)
        is_list = isinstance(self.filters, tuple | list)
        if not (
            is_list and all(isinstance(entry, tuple | list) and len(entry) == 2 for entry in self.filters)
        ):
            raise InvalidArgument(
                "filters", repr(self.filters), 'names and words, such as (("gaussian", "2mm"),)'
            )
        for name, _ in self.filters:  # not the arguments: those of an untrusted stream may name a file
            require_one_of("filters", name, field_filters())
        _ = self.factor, self.device_filter, self.law_spec(1.0)  # each checks its options
        if self.vibration is not None:
            VibrationRule.parse(self.vibration)
            if self.representation == "object":
                message = "--vibration works with --representation voxel or auto, not with object"
                raise InvalidArgument(f"{message}: objects have no samples that could vibrate, so take voxel")
        self._require_spec_of_coder()

    def _require_spec_of_coder(self) -> None:
        """InvalidArgument if the coder's spec is missing, or an unused coder has options."""
        expected = field_coders()[self.coder].spec
        if not isinstance(self.coding, expected or object):
            where = spec_field(self.coder)
            raise InvalidArgument(where, repr(self.coding), f"a {getattr(expected, '__name__', expected)}")
        for other in BUILT_IN_CODERS:
            stray = _changed_fields(getattr(self, other)) if other != self.coder else {}
            for name, value in stray.items():
                raise InvalidArgument(f"{name} {value!r} works with coder {other}, not with {self.coder}")

    @property
    def coding(self) -> Any:
        """The spec of the chosen coder."""
        return getattr(self, spec_field(self.coder))

    @property
    def k(self) -> float:
        """The Weber fraction of the chosen coder; of one that depends on the force, the largest."""
        return float(getattr(self.coding, "largest_k", self.coding.k))

    @property
    def weber(self) -> Weber:
        """The Weber fraction of the chosen coder: a number, or a function of the force."""
        weber: Weber = getattr(self.coding, "weber", self.coding.k)
        return weber

    @property
    def f0_n(self) -> float:
        """F_0 of the mask, newtons: that of the coder, or of a hand if the coder has none."""
        return float(getattr(self.coding, "f0_n", DEFAULT_F0_N))

    def segment_frames_at(self, rate_hz: float) -> int:
        """Frames in an independent segment of a medium of this rate."""
        return segment_length(self.coding.segment_frames, rate_hz)

    def longest_segment_at(self, rate_hz: float) -> int:
        """Limit of the frames of a segment, with those that repeat the frame before."""
        return longest_segment(self.coding.segment_frames, rate_hz)

    @property
    def factor(self) -> float | None:
        """Metres of the hand per metre of the scene; None if the scene is fitted into the workspace."""
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
        """The force law for a device with this F_max."""
        damping = self.surface_damping_n_s_per_m
        return LawSpec(self.law, self.stiffness_n_per_m, force_max_n, self.thickness_m, self.band_m, damping)

    @property
    def chain(self) -> tuple[FieldFilter, ...]:
        """The haptic filters, in order."""
        return tuple(filter_of(name, arguments) for name, arguments in self.filters)

    @property
    def device_filter(self) -> DeviceFilterSpec:
        """The spec of the device filter."""
        return DeviceFilterSpec(oversample=self.oversample, pool=self.pool, cutoff=self.cutoff)

    def to_json(self, has_law: bool = True) -> str:
        """The spec as JSON for a stream's provenance, without the options of unused coders.

        Without `has_law` it has no law and no stiffness, because a receiver would render walls from them.
        """
        values = {**asdict(self), "thickness_m": str(self.thickness_m) if self.thickness_m else None}
        values[self.coder] = asdict(self.coding)
        if not values[self.coder].get("k_by_force", True):
            del values[self.coder]["k_by_force"]  # so that files from before it keep their bytes
        unused = () if has_law else ("law", "stiffness_n_per_m")
        other_coders = (name for name in BUILT_IN_CODERS if name != self.coder)
        kept = ("thin",) if self.thin == "keep" else ()  # as in files from before this option
        for name in (
            *other_coders,
            *kept,
            "extension",
            *(n for n in _OPTIONAL if values[n] is None),
            *unused,
        ):
            del values[name]
        del values["source"]["allow_outside"], values["allow_empty"]  # the user decides these each time
        for name, default in _OPTIONAL_OF_SOURCE.items():
            if values["source"][name] == default:
                del values["source"][name]
        return json.dumps(values, separators=(",", ":"))

    def changed_options(self) -> dict[str, Any]:
        """The options that differ from their defaults, by name."""
        inner = "source", *BUILT_IN_CODERS
        top_level = {
            name: value for name, value in _changed_fields(self).items() if name not in (*inner, "extension")
        }
        specs = [getattr(self, name) for name in inner] + [self.extension] * (self.extension is not None)
        return top_level | {name: value for spec in specs for name, value in _changed_fields(spec).items()}

    @classmethod
    def from_json(cls, text: str) -> EncodeSpec:
        """The spec of a stream, to filter its source again in the same way.

        CorruptFile if the provenance cannot be read.
        """
        try:
            values = json_of(text)
            values["source"] = SourceOptions(**{**values["source"], "allow_outside": False})
            values.pop("allow_empty", None)
            coder = values["coder"]
            spec = coder_entry(coder, "PROV spec").spec
            if spec is None:
                raise ValueError(f"coder {coder!r} codes no fields")
            coding = spec(**values.pop(coder))
            values[spec_field(coder)] = coding
            values.setdefault("thin", "keep")
            if values["thickness_m"] is not None:
                values["thickness_m"] = float(values["thickness_m"])
            for name in ("frames", "fit_frames"):
                if values.get(name) is not None:
                    values[name] = tuple(values[name])
            values["filters"] = tuple(
                (str(name), str(arguments)) for name, arguments in values.get("filters", ())
            )
            return cls(**values)
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            raise CorruptFile(
                "PROV spec", f"a spec that cannot be read ({error})", "what encode wrote"
            ) from None


def spec_with(spec: EncodeSpec | None, options: dict[str, Any]) -> EncodeSpec:
    """Return a spec, the default one if None, with options changed by name.

    An option is a field of `EncodeSpec`, of its `source`, or of the spec of its coder. InvalidArgument for
    any other name; it suggests the closest one.
    """
    spec = EncodeSpec() if spec is None else spec
    if not options:
        return spec
    if "coder" in options:
        require_one_of("coder", options["coder"], CODERS)
        spec = replace(spec, coder=options["coder"])
    inner = {"source": spec.source, spec_field(spec.coder): spec.coding}
    names = {name: {f.name for f in fields(part)} for name, part in inner.items()}
    top_names = {f.name for f in fields(EncodeSpec)}
    changes: dict[str, dict[str, Any]] = {}
    for key, value in options.items():
        place = "" if key in top_names else next((name for name in names if key in names[name]), None)
        if place is None:
            close = get_close_matches(key, [*top_names, *(n for group in names.values() for n in group)], 1)
            hint = f"Is {close[0]} meant?" if close else ""
            expected = "an option of EncodeSpec, of its source or its coder"
            raise InvalidArgument(key, repr(value), expected, hint)
        changes.setdefault(place, {})[key] = value
    parts = {name: replace(part, **changes[name]) for name, part in inner.items() if name in changes}
    return replace(spec, **{**changes.get("", {}), **parts})


@dataclass(frozen=True)
class ReductionSpec:
    """Options of `touchfield.tasks.reduction.reduce_medium`: the modes, and the hand.

    By default the hand pushes with the continuous force of `device`, has the mass of the device and of a
    light hand, and moves at 0.2 m/s.
    """

    modes: str = option("global", "global: of whole frames; bricks: of bricks of 8^3 samples.")
    rank: int | None = option(None, "Modes to keep; default: as many as --nmse-db needs.")
    nmse_db: float = option(-30.0, "Error that determines the number of modes.")
    push_n: float | None = option(None, "Largest force of the hand; default: the device's.")
    mass_kg: float | None = option(None, "Mass of hand and device; default: 50 g and the device's.")
    speed_m_s: float | None = option(None, "Largest speed of the hand; default: 0.2.")
    device: str | None = option(None, "Device in the hand; default: that of MEDIUM.")
    trace: Path | None = option(None, "Positions of a hand: t_s,x_m,y_m,z_m, as of play --log.")

    def __post_init__(self) -> None:
        require_kinds(self)
        if not -200 <= self.nmse_db < 0:
            raise InvalidArgument("nmse_db", repr(self.nmse_db), "decibels below 0, such as -30")


@dataclass(frozen=True)
class Motion:
    """The animation of a model that becomes tracks, and the frame that a stream shows."""

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
