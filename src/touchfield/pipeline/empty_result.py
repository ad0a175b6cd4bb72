"""Refuses a result in which nothing can be felt, and names the option that is most likely to help."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from touchfield.errors import SourceError, with_notes
from touchfield.medium import HapticMedium

if TYPE_CHECKING:
    from touchfield.pipeline.preparation import Prepared

_ALLOW = "--allow-empty writes it all the same."
_WEAK_FRACTION = 0.02  # of the device's largest force; its filter drops forces below half of that


def refuse_empty(prepared: Prepared, supported: int, silent_frames: int = 0) -> None:
    """Raise `SourceError` if nothing in the result can be felt, unless the spec allows that.

    `supported` counts the samples with a force, `silent_frames` the frames that are decoded without theirs. A
    medium with vibrations is never refused. The notes on the source go with the error.
    """
    medium, spec = prepared.medium, prepared.spec
    if spec.allow_empty or medium.vibration is not None:
        return
    if not supported:
        raise _refused(prepared, "no sample has a force", _remedy(prepared))
    if silent_frames == len(medium):
        remedy = f"Try --f0-n {spec.f0_n / 10:.2g}"
        if prepared.has_law:
            remedy += f" or --stiffness-n-per-m {10 * spec.stiffness_n_per_m:g}"
        raise _refused(prepared, f"every force is below F_0, {spec.f0_n:g} N", remedy)


def _refused(prepared: Prepared, found: str, remedy: str) -> SourceError:
    error = SourceError(f"Nothing can be felt: {found}", hint=f"{remedy}. {_ALLOW}")
    return with_notes(error, (*prepared.notes, *prepared.learnt))


def felt_medium(prepared: Prepared) -> HapticMedium:
    """Return the medium of a prepared source; `SourceError` if no frame has a force (see `refuse_empty`).

    Frames are made until one has a force. The medium keeps that frame until it is read for the first time.
    """
    medium, made = prepared.medium, {}
    if prepared.spec.allow_empty or medium.vibration is not None:
        return medium
    for i in range(len(medium)):
        frame = medium[i]
        if frame.support_count:
            made[i] = frame
            break
    else:
        refuse_empty(prepared, 0)
    return replace(medium, make_frame=lambda i: made.pop(i, None) or medium[i])


def _remedy(prepared: Prepared) -> str:
    """The option to change, as a sentence without its full stop."""
    spec = prepared.spec
    if not prepared.has_law:
        return "The source itself has no force there: take other --frames, or another source"
    largest_n = spec.stiffness_n_per_m * min(prepared.device.workspace_m)
    if largest_n < _WEAK_FRACTION * prepared.device.force_max_n:
        weak = f"{spec.stiffness_n_per_m:g} N/m makes less than {largest_n:.2g} N in the whole workspace"
        return f"{weak}; the same in N/mm is --stiffness-n-per-m {1e3 * spec.stiffness_n_per_m:g}"
    if spec.mapping != "fit":
        return f"With --mapping {spec.mapping} the scene may lie outside the workspace: try --mapping fit"
    spacing_m = max(prepared.medium.grid.spacing_m)
    if spec.thickness_m is not None and spec.thickness_m < spacing_m:
        gap = f"A wall of {1e3 * spec.thickness_m:.3g} mm is thinner than the {1e3 * spacing_m:.3g} mm"
        return f"{gap} between samples: try --thickness-m {math.ceil(2e3 * spacing_m) / 1e3:g}"
    start, end = spec.fit_frames or spec.frames or (0, None)
    stop = len(prepared.medium) if end is None else end
    scale = f"{1e-3 / prepared.placement.scale:.4g} m"
    if stop - start > 1:
        where = f"1 mm of the hand is {scale} of the scene, so that frames {start} to {stop - 1} fit"
        return f"{where}: try --fit-frames {start}:{start + 1}, or fewer --frames"
    finer = f"try --nw {spec.nw + 1}" if spec.nw is not None and spec.nw < 10 else "try --mapping crop"
    return f"1 mm of the hand is {scale} of the scene, which may be too small for the lattice: {finer}"
