"""Options of coder `paper`, either as the paper prints them (*literal*) or with its errors corrected, and the
coder's entry in the registry.

Source: figure 4 and section 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Final

from touchfield.codec.paper.quantisers import weber_ladder
from touchfield.codec.registry import Coder
from touchfield.errors import InvalidArgument, require_kinds
from touchfield.options import option

STAGES: Final = ("none", "dpcm", "adpcm", "dct", "wavelet", "runs")
"""Names of the stages; "none" means no stage."""

_CHOICES: Final = {
    "amplitude": ("lloyd-max", "weber", "uniform"),
    "deadband": ("closed", "last-sent", "previous", "zero", "none"),
    "interframe": ("closed", "open", "none"),
    "weber_levels": ("auto", "needed", "full"),
    "stage": STAGES,
}


@dataclass(frozen=True)
class PaperSpec:
    """Options of the paper's coder.

    InvalidArgument if an option is invalid, or has no effect with the chosen stage.
    """

    k: float = option(0.1, "Weber fraction of the deadband. [default: 0.1]")
    """Weber fraction of the deadband (eq. 8), between 0 and 1."""
    nq: int = option(6, "bits of amplitude. [default: 6]")
    """n_q: 2^n_q amplitude levels, 1 to 12; for the Weber ladder see `weber_levels`."""
    directions: str = option("auto", "codebook: ico5 (252), octa3 (258), ico3 (92), ico1 to ico20.")
    """Codebook: ico5 (252 vertices), octa3 (258, the paper's count), ico3 (92), ico1 to ico20; "auto" is ico5
    for a point device, and octa1 for an array, whose forces all lie along one axis."""
    amplitude: str = option("lloyd-max", "amplitude quantiser: lloyd-max (default), weber or uniform.")
    """Amplitude quantiser: "lloyd-max" (the paper's), "weber" (the corrected eq. 6) or "uniform"."""
    deadband: str = option("closed", "closed, last-sent, previous, zero or none. [default: closed]")
    """Reading of eq. 8 within a frame: "closed" (compares the vector with the decoded reference, with the k'
    that guarantees k), "last-sent", "previous" (as printed), "zero" (as printed, but a held sample is stored
    as zero), or "none". See `touchfield.perception.weber`."""
    interframe: str = option("closed", "closed, open or none. [default: closed]")
    """Prediction between frames: "closed" (difference to the decoded previous frame), "open" (difference to
    the original previous frame, as printed; errors accumulate), or "none" (every frame on its own)."""
    choose_by_size: bool = True
    """Whether to code each frame on its own or as a difference, whichever is smaller; the literal coder
    always codes the difference."""
    hold_runs: bool = True
    """Whether to code held samples in runs; the literal coder writes one zero symbol for each."""
    segment_frames: int = option(8, "frames in an independent segment. [default: 8]")
    """Frames in an independent segment, 1 to 4096."""
    weber_levels: str = "auto"
    """Number of levels of the Weber ladder: "needed" (as many as k needs from F_min on), "full" (2^n_q
    including zero, from the largest force down: n_q = 6 gives the 6 bits per sample of table 2), or "auto"
    ("full" for an array, "needed" for a point)."""
    stage: str = option("none", "dpcm, adpcm, dct, wavelet or runs in place of all these. [default: none]")
    """A coding stage of figure 4 that replaces deadband, levels, directions and differences: "dpcm", "adpcm"
    (predictive), "dct", "wavelet" (spectral) or "runs" (run-length). It codes components in uniform steps,
    each frame on its own."""
    step_n: float = option(0.05, "with --stage: its step, newtons. [default: 0.05]")
    """Step of the stage, newtons, 1e-9 to 1e6."""

    def __post_init__(self) -> None:
        require_kinds(self, **_CHOICES)
        if not 0 < self.k < 1:
            raise InvalidArgument("k", repr(self.k), "a Weber fraction between 0 and 1, such as 0.1")
        if not 1 <= self.nq <= 12:
            raise InvalidArgument("nq", repr(self.nq), "1 to 12 bits of amplitude")
        if not 1 <= self.segment_frames <= 4096:
            raise InvalidArgument("segment_frames", repr(self.segment_frames), "1 to 4096 frames")
        if not 1e-9 <= self.step_n <= 1e6:
            raise InvalidArgument("step_n", repr(self.step_n), "newtons, from 1e-9 to 1e6")
        if self.amplitude == "weber" and self.weber_steps is not None:
            weber_ladder(self.k, 1.0, self.weber_steps)  # report invalid values early
        with_any, is_staged = ("k", "segment_frames", "stage"), self.stage != "none"
        for part in fields(self):
            is_idle = part.name not in with_any and (part.name == "step_n") != is_staged
            if is_idle and getattr(self, part.name) != part.default:
                expected = "it without a stage only" if is_staged else "it with a stage only"
                raise InvalidArgument(part.name, f"it with stage {self.stage}", expected)

    def for_device(self, is_array: bool) -> PaperSpec:
        """The spec with every "auto" resolved for a kind of device."""
        if self.stage != "none":
            return self
        levels = self.weber_levels if self.weber_levels != "auto" else "full" if is_array else "needed"
        directions = self.directions if self.directions != "auto" else "octa1" if is_array else "ico5"
        return replace(self, directions=directions, weber_levels=levels)

    @property
    def weber_steps(self) -> int | None:
        """Number of levels above zero of a full Weber ladder; None if k determines it."""
        return 2**self.nq - 1 if self.weber_levels == "full" else None

    @classmethod
    def literal(cls, **options: Any) -> PaperSpec:
        """The coder as the paper prints it.

        Eq. 8 compares amplitudes, the loop between frames is open, and differences are always coded.
        """
        printed = cls(
            directions="octa3", deadband="previous", interframe="open", choose_by_size=False, hold_runs=False
        )
        return replace(printed, **options)


CODER = Coder(
    name="paper",
    encoder="touchfield.codec.paper.encoder:PaperEncoder",
    decoder="touchfield.codec.paper.decoder:PaperDecoder",
    spec=PaperSpec,
    makers={
        "paper": lambda options: PaperSpec(**options),
        "paper-literal": lambda options: PaperSpec.literal(**options),
    },
    resolve=PaperSpec.for_device,
    summary=lambda spec: {"stage": spec.stage} if spec.stage != "none" else {},
    has_codewords=True,
)
