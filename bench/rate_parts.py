"""The parts of `rate.py`'s comparisons, each of one field and apart from the others, as numbers for a file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rate_contest as contest
import rate_ours as ours
import rate_peers as peers
import rate_symbols as lattices
from rate_fields import Volume
from touchfield.medium import ForceField

Figures = dict[str, Any]

STEPS_N = (0.4, 0.24, 0.14, 0.08, 0.045, 0.025)
"""Of the curves."""
TOLERANCES = {"zfp": 8.0, "SZ3": 0.6, "SPERR": 0.7}
"""Times the steps: what takes each of the lossy coders over the same errors."""
PAPER = ((3, "ico3"), (4, "ico3"), (4, "octa3"), (6, "octa3"), (8, "ico10"), (8, "ico20"))
"""n_q and directions of a curve, coarse to fine."""


def equal(frames: list[ForceField], efforts: list[str]) -> Figures:
    """One frame by our coders at the NMSE of coder `paper`."""
    paper = ours.paper(frames[:1])
    figures: Figures = {"paper": paper.bytes, "nmse_db": paper.nmse_db, "touch": {}}
    step = ours.first_step(frames[:1], paper.nmse_db)
    for effort in efforts:
        search = ours.touch_search(frames[:1], paper.nmse_db, effort, step * ours.FINER[effort])
        step = search.step()
        figures["touch"][effort] = search.size()
        figures |= {"step_n": step, "slope": search.slope_found(), "trials": len(search.tried)}
    return figures


def equal_peers(frames: list[ForceField]) -> Figures:
    """One frame by all peers at that NMSE, and coder `paper`'s symbols by general coders."""
    target_db = ours.paper(frames[:1]).nmse_db
    return {
        "peers": contest.peers_at_error(Volume.of(frames[:1]), target_db),
        "on_paper": contest.peers_on_paper(frames[:1]),
    }


def promise(frames: list[ForceField], efforts: list[str]) -> Figures:
    """One frame under the promise."""
    made = {effort: ours.touch(frames[:1], effort=effort) for effort in efforts}
    return {
        "touch": {effort: one.bytes for effort, one in made.items()},
        "beyond": sum(one.beyond for one in made.values()),
        "worst": max(one.worst for one in made.values()),
        "nmse_db": {effort: one.nmse_db for effort, one in made.items()},
        "voxels": frames[0].support_count,
    }


def promise_peers(frames: list[ForceField]) -> Figures:
    """One frame by the peers, which keep the promise too."""
    return {"peers": contest.peers_at_promise(Volume.of(frames[:1]))}


def five_equal(
    frames: list[ForceField], effort: str, interframe: str, step_n: float, slope: float, once: bool
) -> Figures:
    """All frames in a segment at the NMSE of coder `paper`, from the step of one frame on.

    With `once` a trial within 0.4 dB is enough, carried to the NMSE along the slope of the first frame.
    """
    target_db = ours.paper(frames, interframe="none").nmse_db
    asked: dict[str, Any] = {"near_db": 0.4, "trials": 3} if once else {}
    search = ours.touch_search(frames, target_db, effort, step_n, interframe=interframe, slope=slope, **asked)
    return {"nmse_db": target_db, "bytes": search.size(), "later_bits": search.size(1), "trials": len(search.tried)}


def five_promise(frames: list[ForceField], effort: str, interframe: str) -> Figures:
    """All frames in a segment under the promise."""
    made = ours.touch(frames, effort=effort, interframe=interframe)
    return {"bytes": made.bytes, "later_bits": sum(made.frame_bits[1:]), "beyond": made.beyond}


def five_equal_peers(frames: list[ForceField]) -> Figures:
    """All frames by the peers at the NMSE of coder `paper`, and its symbols."""
    target_db = ours.paper(frames, interframe="none").nmse_db
    return {
        "peers": contest.peers_at_error(Volume.of(frames), target_db),
        "on_paper": contest.peers_on_paper(frames),
    }


def five_promise_peers(frames: list[ForceField]) -> Figures:
    """All frames by the peers under the promise."""
    return {"peers": contest.peers_at_promise(Volume.of(frames))}


def curve(frames: list[ForceField], effort: str, step_n: float) -> Figures:
    """A point (NMSE in dB, bytes) of coder `touch`."""
    made = ours.touch(frames[:1], mode="nmse", step_n=step_n, effort=effort)
    return {"touch": [[made.nmse_db, made.bytes]]}


def curve_paper(frames: list[ForceField]) -> Figures:
    """Points of coder `paper`."""
    made = [ours.paper(frames[:1], nq=nq, directions=directions) for nq, directions in PAPER]
    return {"paper": [[one.nmse_db, one.bytes] for one in made]}


def curve_peers(frames: list[ForceField], step_n: float) -> Figures:
    """A point of every peer."""
    volume = Volume.of(frames[:1])
    quantised = lattices.uniform(volume.forces_n, step_n)
    error = volume.nmse_db(quantised.decoded)
    points: Figures = {name: [[error, size]] for name, size in peers.lossless(quantised.symbols).items()}
    cloud = peers.draco(quantised.symbols)
    if cloud is not None:
        points["Draco"] = [[error, cloud]]
    for name, code in peers.lossy().items():
        size, decoded = code(volume.forces_n, TOLERANCES[name] * step_n)
        points[name] = [[volume.nmse_db(decoded), size]]
    return points


PARTS: dict[str, Callable[..., Figures]] = {
    part.__name__: part
    for part in (
        equal, equal_peers, promise, promise_peers, five_equal, five_promise, five_equal_peers, five_promise_peers,
        curve, curve_paper, curve_peers,
    )
}  # fmt: skip

WORK = {
    "equal": 0.5, "equal_peers": 0.5, "promise": 0.15, "promise_peers": 0.6, "five_equal": 1.2, "five_promise": 0.6,
    "five_equal_peers": 1.5, "five_promise_peers": 2.0, "curve": 0.4, "curve_paper": 0.01, "curve_peers": 0.3,
}  # fmt: skip
"""Milliseconds a voxel of the first frame, about: for the order and the time that is left."""
