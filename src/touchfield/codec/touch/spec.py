"""Options of coder `touch` (mode, error bound, effort and others), checked, and the coder's entry in the
registry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from touchfield.codec.registry import Coder
from touchfield.codec.segment import BoundRule, mask_text
from touchfield.errors import InvalidArgument, require_kinds
from touchfield.options import option

if TYPE_CHECKING:
    from touchfield.perception.grip import WeberCurve

MODES: Final = ("mask", "mask-direction", "nmse", "lossless")
EFFORTS: Final = ("fast", "default")
SUPPORTS: Final = ("movable", "exact")
_CHOICES: Final = {
    "mode": MODES, "effort": EFFORTS, "support": SUPPORTS, "guess": ("auto", "off"),
    "interframe": ("auto", "off", "on"),
}  # fmt: skip


@dataclass(frozen=True)
class TouchSpec:
    """Options of the coder `touch`; InvalidArgument if one is out of range."""

    k: float = option(0.1, "Weber fraction of the error bound. [default: 0.1; of pins half a step]")
    """Weber fraction of the error bound |F_dec - F| <= max(F_0, k |F|), 0.001 to below 1."""
    f0_n: float = option(0.05, "F_0 of the error bound, newtons. [default: 0.05]")
    """F_0, newtons, 0 or more."""
    mode: str = option("mask", "mask (|error| <= max(F_0, k |F|); default), mask-direction, or nmse.")
    """One of "mask" (the error bound above); "mask-direction" (| |F_dec| - |F| | <= max(F_0, k |F|), and the
    angle between both forces is at most `direction_jnd_deg` if |F| > F_0 / sin(`direction_jnd_deg`);
    elsewhere the error is at most F_0); "nmse" (no error bound: the fewest bytes for a mean squared error,
    which `step_n` sets); "lossless" (bit for bit, for a field that is already quantised)."""
    direction_jnd_deg: float = option(18.4, "mask-direction: greatest angle, degrees. [default: 18.4]")
    """Just noticeable difference of a direction, degrees, above 0 and below 90; by default the smallest for a
    hand on a device (Barbagli and others 2006, docs: perception.md)."""
    step_n: float = option(0.05, "mode nmse: step of the lattice, newtons. [default: 0.05]")
    """Step of the uniform lattice of mode "nmse", newtons."""
    effort: str = option("default", "default, or fast: up to 1.7 times as fast, decodes nothing to check.")
    """Either "fast" or "default"; both write the same bytes and keep the error bound. "default" decodes its
    own bytes to check the bound. "fast" checks the encoder's reconstruction, which a decoder reproduces bit
    for bit, and is faster."""
    support: str = option("movable", "movable (where |F| is at most F_0), or exact. [default: movable]")
    """Either "movable" (a force of at most F_0 may vanish or appear) or "exact" (the support is kept)."""
    masking: float = option(0.0, "fraction of the mean surrounding force added to the bound. [default: 0]")
    """Spatial masking, mode "mask" only: fraction beta, 0 to 1, of the mean surrounding force by
    which the bound of a voxel grows. The error bound is then max(F_0, k |F| + beta mean), see
    `touchfield.perception.SpatialMasking`. 0: none."""
    masking_radius_m: float = 0.0025
    """Radius R of that mean, metres: the two-point threshold of the skin, by default that of a finger."""
    k_by_force: tuple[tuple[float, float], ...] = ()
    """The Weber fraction as a function of force, mode "mask" only: points (newtons, k) of a
    `touchfield.perception.WeberCurve`, of which `k` is the smallest k (`for_grip`). The error bound is then
    max(F_0, k(|F|) |F|). Empty: k is the same for every force. The provenance of a file stores the points."""
    guess: str = "auto"
    """Whether a frame may have a base layer (spline or columns): "auto" (the encoder decides), or "off"."""
    interframe: str = option("auto", "auto, off or on. [default: auto]")
    """Whether a frame is predicted from the one before: "auto" (if enough of it is within the bound), "off",
    "on"."""
    segment_frames: int | None = option(None, "frames a segment. [default: half a second, 8 to 64]")
    """Frames in an independent segment, 1 to 4096; None: from the medium's rate (`codec.segment`)."""

    def __post_init__(self) -> None:
        require_kinds(self, **_CHOICES)
        frames = self.segment_frames
        for name, fits, expected in (
            ("k", 0.001 <= self.k < 1, "a Weber fraction from 0.001 to below 1, such as 0.1"),
            ("f0_n", 0 <= self.f0_n < math.inf, "newtons, 0 or more, such as 0.05"),
            ("direction_jnd_deg", 0 < self.direction_jnd_deg < 90, "degrees above 0 and below 90"),
            ("step_n", 0 < self.step_n < math.inf, "newtons above 0"),
            ("segment_frames", frames is None or 1 <= frames <= 4096, "1 to 4096 frames"),
            ("masking", 0 <= self.masking <= 1, "a fraction from 0 to 1, such as 0.05"),
            ("masking_radius_m", 1e-6 <= self.masking_radius_m <= 1, "metres from 1e-6 to 1"),
        ):
            if not fits:
                raise InvalidArgument(name, repr(getattr(self, name)), expected)
        for name in ("masking", "k_by_force"):
            if getattr(self, name) and self.mode != "mask":
                raise InvalidArgument(name, f"it in mode {self.mode}", "it in mode mask only")
        if self.k_by_force:
            object.__setattr__(self, "k_by_force", self._checked_points())

    def _checked_points(self) -> tuple[tuple[float, float], ...]:
        """The points of `k_by_force`, also if they were lists (of JSON)."""
        from touchfield.perception.grip import WeberCurve

        curve = WeberCurve.of(self.k_by_force)
        if self.k != curve.least:
            hint = "TouchSpec.for_grip sets both."
            raise InvalidArgument("k", repr(self.k), f"{curve.least:g}, the smallest of k_by_force", hint)
        return curve.points

    @classmethod
    def for_grip(cls, name: str, **options: Any) -> TouchSpec:
        """The spec with F_0 and k(|F|) of a grip: "stylus", "ball" or "finger" (docs: perception.md).

        `options` are other fields. `InvalidArgument` if there is no such grip, or `options` has `k` or
        `f0_n`.
        """
        from touchfield.perception.grip import grip

        for key in ("k", "f0_n", "k_by_force"):
            if key in options:
                expected = "one of both: the grip sets it"
                raise InvalidArgument(_option(key), f"it together with grip {name}", expected)
        bound = grip(name)
        return cls(k=bound.weber.least, f0_n=bound.f0_n, k_by_force=bound.weber.points, **options)

    @property
    def weber(self) -> float | WeberCurve:
        """The Weber fraction of the error bound: `k`, or the function of `k_by_force`."""
        if not self.k_by_force:
            return self.k
        from touchfield.perception.grip import WeberCurve

        return WeberCurve(self.k_by_force)

    @property
    def grip_note(self) -> str:
        """Which numbers of the bound were not measured for its grip; empty if none, or without a grip."""
        if not self.k_by_force:
            return ""
        from touchfield.perception.grip import grips

        bound = self.f0_n, self.k_by_force
        notes = (known.note for known in grips().values() if (known.f0_n, known.weber.points) == bound)
        return next(notes, "")

    @property
    def largest_k(self) -> float:
        """The Weber fraction that bounds the relative error at every force: the largest of `k_by_force`."""
        return max((k for _, k in self.k_by_force), default=self.k)


def _spec(options: dict[str, Any]) -> TouchSpec:
    """Spec from options, with the mode they imply.

    InvalidArgument for an option without effect in that mode.
    """
    values = dict(options)
    if values.pop("lossless_quantised", False):
        for key in ("mode", "k", "f0_n", "support"):
            if key in values:
                found = "it together with --lossless-quantised, which keeps every force as it is"
                raise InvalidArgument(_option(key), found, "one of both")
        values["mode"] = "lossless"
    if values.pop("target_nmse_db", None) is not None:
        values = {"mode": "nmse", **values}
    site = values.pop("body_site", None)
    if site is not None:
        if not values.get("masking"):
            raise InvalidArgument("--body-site", "it without --masking", "both", "Add --masking 0.05.")
        from touchfield.perception.mask import site_radius_m

        values["masking_radius_m"] = site_radius_m(site)
    mode = values.get("mode", TouchSpec.mode)
    for key, only in (("direction_jnd_deg", "mask-direction"), ("step_n", "nmse")):
        if key in values and mode != only:
            found, expected = f"it in mode {mode}", f"it in mode {only} only"
            raise InvalidArgument(_option(key), found, expected, f"Add --mode {only}.")
    profile = values.pop("profile", None)
    if profile is not None:
        return TouchSpec.for_grip(_grip_of(profile), **values)
    return TouchSpec(**values)


def _grip_of(profile: str) -> str:
    """The grip of ``--profile grip=NAME``."""
    key, equals, name = profile.partition("=")
    if key != "grip" or not equals:
        raise InvalidArgument("--profile", repr(profile), "grip=stylus, grip=ball or grip=finger")
    return name


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")


def _summary(spec: TouchSpec) -> dict[str, Any]:
    extra = (
        {"step_n": spec.step_n} if spec.mode == "nmse" else {"masking": spec.masking} if spec.masking else {}
    )
    return {"mode": spec.mode, "effort": spec.effort, **extra}


def _bound(spec: TouchSpec) -> BoundRule:
    """Error bound of a mode, as text."""
    floor, relative = f"{spec.f0_n:g} N", f"{spec.k:g} |F|"
    if spec.mode == "lossless":
        return BoundRule("every force bit for bit")
    if spec.mode == "mask":
        masking = f" + {spec.masking:g} of the mean force within {1e3 * spec.masking_radius_m:g} mm"
        by_force = spec.weber.text if spec.k_by_force and not isinstance(spec.weber, float) else ""
        return BoundRule(mask_text(spec.k, spec.f0_n, masking if spec.masking else "", by_force))
    if spec.mode == "mask-direction":
        angle = f"{spec.direction_jnd_deg:g} degrees"
        length = f"the length within max({floor}, {relative}) and the direction within {angle}"
        return BoundRule(f"{length} where |F| > {floor} / sin({angle}), elsewhere |error| <= {floor}")
    reason = f"mode {spec.mode} keeps a mean squared error, which bounds no single voxel; take --mode mask"
    return BoundRule(None, reason)


_OPTIONS: Final = (
    "k", "segment_frames", "f0_n", "mode", "direction_jnd_deg", "step_n", "support", "effort", "masking",
    "body_site", "profile", "lossless_quantised", "interframe",
)  # fmt: skip

CODER = Coder(
    name="touch",
    encoder="touchfield.codec.touch.encoder:TouchEncoder",
    decoder="touchfield.codec.touch.decoder:TouchDecoder",
    spec=TouchSpec,
    makers={"touch": _spec},
    options=_OPTIONS,
    extra_options={
        "profile": (str, "k by force and F_0 of a grip: grip=stylus, grip=ball or grip=finger."),
        "body_site": (str, "masking: body site in contact: finger, palm, belly, forearm. [default: finger]"),
        "lossless_quantised": (bool, "keep a field that is quantised already exactly."),
    },
    hints=("target_nmse_db",),
    summary=_summary,
    bound=_bound,
    has_error_bound=True,
)
