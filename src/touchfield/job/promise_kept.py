"""What the segments of coder `touch` promise, put together: the worst voxel of a whole file, and the guesses sent."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from touchfield.codec.touch.body import TouchCost
    from touchfield.codec.touch.promise import Promise

__all__ = ["FILTERED", "OWN_FORCES", "guesses_used", "promise_kept"]

FILTERED: Final = "the device-filtered field, behind any haptic filters"
"""What a promise is held against, unless a file tells otherwise; `touchfield field` writes it."""

OWN_FORCES: Final = "the source's own forces, sample by sample"
"""Where the source is a stored field on the lattice of the file, and no haptic filter is asked for."""


def promise_kept(segments: Iterable[tuple[int, Promise]]) -> dict[str, Any]:
    """Stable keys for people and programs: the mode, and the largest |error| / allowed and where it is.

    Parameters
    ----------
    segments : iterable of (int, Promise)
        The first frame of each segment, and what it promises.

    Returns
    -------
    dict
        Empty for no segment; in mode "nmse", which promises nothing, the ratio and its place are None.
    """
    mode = None
    jnd_deg: float | None = None
    worst: tuple[float, int, list[int]] | None = None
    for first, promise in segments:
        mode, jnd_deg, found = promise.mode, promise.direction_jnd_deg, promise.worst
        if found is not None and (worst is None or found.ratio > worst[0]):
            worst = found.ratio, first + found.frame, list(found.voxel)
    if mode is None:
        return {}
    ratio, frame, voxel = (None, None, None) if worst is None else worst
    return {
        "mode": mode,
        **({} if jnd_deg is None else {"direction_jnd_deg": jnd_deg}),
        "promise_kept": None if ratio is None else ratio <= 1,
        "worst_mask_ratio": ratio,
        "worst_frame": frame,
        "worst_voxel": voxel,
    }


def guesses_used(costs: Iterable[TouchCost]) -> dict[str, Any]:
    """Stable keys: frames that came with a guess, and side bits of guesses and of corrections."""
    every = list(costs)
    return {
        "guesses": sum(cost.guess_bits > 0 for cost in every),
        "bits_guesses": sum(cost.guess_bits for cost in every),
        "bits_sent_apart": sum(cost.exception_bits for cost in every),
    }
