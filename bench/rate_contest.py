"""The general-purpose coders of `rate.py` at an equal mean error, and at the promise."""

from __future__ import annotations

from typing import Any

import numpy as np

import rate_ours as ours
import rate_peers as peers
import rate_symbols as lattices
from rate_fields import Volume, box
from rate_search import Search
from touchfield.medium import ForceField

K, F0_N = ours.K, ours.F0_N


def peers_at_error(volume: Volume, target_db: float) -> dict[str, float]:
    """Bytes of every peer at an NMSE."""
    found: dict[str, float] = {}
    start = float(np.sqrt(12 * volume.energy / volume.forces_n.size * 10 ** (target_db / 10)))
    for name, code in peers.lossy().items():

        def coded(tolerance: float, code: peers.Lossy = code) -> tuple[float, float]:
            size, decoded = code(volume.forces_n, tolerance)
            return volume.nmse_db(decoded), float(size)

        found[name] = Search(coded, target_db, start, trials=9).run().size() + Volume.HEAD_BYTES
    low, high = start / 8, start * 16
    for _ in range(14):
        middle = (low * high) ** 0.5
        if volume.nmse_db(lattices.uniform(volume.forces_n, middle).decoded) <= target_db:
            low = middle
        else:
            high = middle
    symbols = lattices.uniform(volume.forces_n, low).symbols
    return found | _of_symbols(symbols)


def peers_on_paper(frames: list[ForceField]) -> dict[str, float]:
    """Bytes by general coders of what coder `paper` would send of frames coded alone, in place of its own code.

    The amplitude's level and the direction's number of each voxel, the tables of amplitudes beside them. Their error
    is that of coder `paper`.
    """
    symbols, table_bytes = ours.paper_symbols(frames)
    cut = np.stack([frame[box(frames)] for frame in symbols])
    sizes = peers.lossless(cut, of_forces=False)
    return {name: float(size + table_bytes + Volume.HEAD_BYTES) for name, size in sizes.items()}


def _of_symbols(symbols: peers.Symbols, with_draco: bool = True) -> dict[str, float]:
    found = {name: float(size + Volume.HEAD_BYTES) for name, size in peers.lossless(symbols).items()}
    cloud = peers.draco(symbols) if with_draco else None
    return found if cloud is None else {**found, "Draco": float(cloud)}


def peers_at_promise(volume: Volume) -> dict[str, float]:
    """Bytes of every peer that keeps the promise at every voxel; symbols on the two best lattices."""
    found: dict[str, float] = {}
    made = sorted(lattices.promised(volume.forces_n, K, F0_N), key=lambda q: peers.first_guess(q.symbols))
    for one in made[:2]:
        assert lattices.is_kept(volume.forces_n, one.decoded, K, F0_N)
        for name, size in _of_symbols(one.symbols, with_draco=one is made[0]).items():
            found[name] = min(size, found.get(name, np.inf))
    companded = lattices.compand(volume.forces_n, K, F0_N).astype(np.float32)
    for name, code in peers.lossy().items():
        plain = _coarsest(lambda t, c=code: c(volume.forces_n, t), lambda d: d, volume, F0_N)
        bent = _coarsest(lambda t, c=code: c(companded, t), lambda d: lattices.expand(d, K, F0_N), volume, 1.0)
        found[name] = min(plain, bent) + Volume.HEAD_BYTES
    return found


def _coarsest(code: Any, decode: Any, volume: Volume, start: float) -> float:
    """The fewest bytes among tolerances, halved and doubled, that leave no voxel beyond the mask."""
    found, low, high = np.inf, start / 16, start * 4
    for _ in range(6):
        middle = (low * high) ** 0.5
        size, decoded = code(middle)
        if lattices.is_kept(volume.forces_n, decode(decoded), K, F0_N):
            found, low = min(found, size), middle
        else:
            high = middle
    return found
