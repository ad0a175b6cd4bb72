"""The settings of the paper's coder that spend bits best: min R + lambda D over (n_w, k, n_q, N_d) (paper section 4).

R is the whole file in bits a frame, D either the NMSE (the ratio of energies of eq. 10, not in dB) or how many voxels
are beyond the mask. lambda is what one unit of D is worth in bits a frame: 0 asks for the smallest file, and a
great one for the best field.

Settings of different n_w are compared on one lattice, that of the greatest n_w: a coarser stream is decoded and
interpolated there as a receiver does, so that what a coarse lattice leaves out counts. The mask is the same for all,
that of the spec, whatever k the coder took.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Final

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.interpolate import interpolated
from touchfield.job.encode import encode
from touchfield.job.optimum import Optimisation, Trial
from touchfield.job.prepare import Prepared, open_scene, prepare
from touchfield.job.spec import DEFAULT_F0_N, EncodeSpec, Report, silent
from touchfield.job.stream import open_stream
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, HapticMedium
from touchfield.sources.scene import Scene
from touchfield.sources.stored import StoredScene

__all__ = ["SearchGrid", "optimise"]

FRAMES: Final = 2
"""Frames that are tried where none are named: one alone, and one that differs."""

MOST_TRIALS: Final = 4096


@dataclass(frozen=True)
class SearchGrid:
    """The settings to try, every one with every other; the paper's own by default (section 5.2).

    Parameters
    ----------
    nw, nq : tuple of int
    k : tuple of float
    directions : tuple of str
        Direction codebooks, for N_d.

    Raises
    ------
    InvalidArgument
        If an axis is empty, or there are more than 4096 settings.
    """

    nw: tuple[int, ...] = (5, 6)
    k: tuple[float, ...] = (0.01, 0.1, 0.25)
    nq: tuple[int, ...] = (4, 6, 8)
    directions: tuple[str, ...] = ("ico3", "ico5")

    def __post_init__(self) -> None:
        for name in ("nw", "k", "nq", "directions"):
            object.__setattr__(self, name, tuple(dict.fromkeys(getattr(self, name))))
        if not 1 <= len(self) <= MOST_TRIALS:
            raise InvalidArgument("search grid", f"{len(self)} settings", f"1 to {MOST_TRIALS}")

    def __len__(self) -> int:
        return len(self.nw) * len(self.k) * len(self.nq) * len(self.directions)


def optimise(
    source: str | Path | Scene,
    spec: EncodeSpec | None = None,
    search: SearchGrid | None = None,
    report: Report = silent,
) -> Optimisation:
    """Code a source under every setting of a grid, as voxels, and measure size and fidelity.

    Parameters
    ----------
    source : path or Scene
    spec : EncodeSpec, optional
        Everything but the coder, which is `paper`, n_w, k, n_q and the directions. Its ``paper.k`` is the Weber
        fraction of the mask; of its frames, or of the first two where it names none, each setting makes a file.
    search : SearchGrid, optional
        An array has its own lattice: of several n_w the first is taken.
    report : callable
        ``report(done, total)`` in settings.

    Raises
    ------
    TouchfieldError
        If a setting is not possible, or the frames hold no force.
    """
    spec, search = spec or EncodeSpec(), search or SearchGrid()
    if spec.coder != "paper":
        spec = replace(spec, coder="paper", touch=TouchSpec())
    base = replace(spec, representation="voxel")
    coders = [
        replace(spec.paper, k=k, nq=nq, directions=d) for k, nq, d in product(search.k, search.nq, search.directions)
    ]
    scene = open_scene(source, spec.source)
    finest = _prepared(scene, replace(base, nw=max(search.nw)))
    nws = search.nw[:1] if finest.device.is_array else search.nw
    reference = tuple(finest.medium)
    if not any(f.support_count for f in reference):
        raise InvalidArgument("source to optimise for", f"{len(reference)} frames without a force", "a force")
    total = len(nws) * len(coders)
    trials: list[Trial] = []
    for trial in _trials(scene, base, nws, coders, (finest, reference)):
        trials.append(trial)
        report(len(trials), total)
    return Optimisation(tuple(trials), spec.paper.k, DEFAULT_F0_N)


def _trials(
    scene: Scene,
    base: EncodeSpec,
    nws: tuple[int, ...],
    coders: list[PaperSpec],
    finest: tuple[Prepared, tuple[ForceField, ...]],
) -> Iterator[Trial]:
    """Every setting measured, n_w by n_w, so that the fields of one lattice are made once."""
    reference = finest[1]
    for nw in nws:
        asked = replace(base, nw=nw)
        is_finest = asked == finest[0].spec or finest[0].device.is_array
        prepared = finest[0] if is_finest else _prepared(scene, asked)
        same = prepared.medium.grid == reference[0].grid
        fields = reference if same else tuple(prepared.medium)
        kept = HapticMedium.from_frames(fields, prepared.medium.rate_hz, prepared.medium.axes)
        for paper in coders:
            yield _trial(StoredScene(kept), replace(asked, paper=paper), reference, base.paper.k)


def _trial(stored: StoredScene, spec: EncodeSpec, reference: tuple[ForceField, ...], k: float) -> Trial:
    """One setting, coded to a file and decoded from it."""
    meter, grid = FidelityMeter(k, DEFAULT_F0_N), reference[0].grid
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial.touch"
        # what is stored has been cut and filtered before
        encoded = encode(stored, path, replace(spec, frames=None, filters=()))
        with open_stream(path) as opened:
            shown: Callable[[ForceField], ForceField] = lambda f: f  # noqa: E731
            if opened.grid.shape != grid.shape:
                shown = lambda f: interpolated(f, grid, border="cell")  # noqa: E731
            for original, decoded in zip(reference, opened.medium, strict=True):
                meter.add(original, shown(decoded))
    nmse = 0.0 if meter.nmse_db is None else 10 ** (meter.nmse_db / 10)
    beyond_mask = meter.mask_violations / meter.supported_voxels
    return Trial(spec, encoded.file_bytes, len(reference), nmse, beyond_mask)


def _prepared(scene: Scene, spec: EncodeSpec) -> Prepared:
    """The frames to try, after the device filter and the haptic filters."""
    prepared = prepare(scene, spec)
    if spec.frames is not None:
        return prepared
    return replace(prepared, medium=prepared.medium.between(0, min(FRAMES, len(prepared.medium))))
