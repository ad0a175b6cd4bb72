"""Reproduces table 2 of the paper: sizes, entropies and bits of two scenes for a tactile T-shirt (section
5.1).

1024 actuators, 32 x 32, each of which renders one magnitude: every frame is counted whole. *Literal* has the
cut-off 2/d of the paper's section 3.2, four times the Nyquist rate of the array; *corrected* 1/(2d).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from reproduction.experiment import Experiment, Finding, Inputs, markdown_table
from reproduction.later_frames import LaterFrames, consecutive_runs, later_frames
from reproduction.perceptual_bits import PerceptualFilter, six_bits
from reproduction.printed_tables import PRINTED_2, identity_table
from reproduction.progress import Steps
from reproduction.section_5_1 import READINGS, PaperScene, scenes
from reproduction.table_1_counts import MASK_K
from reproduction.table_wording import count, percent
from touchfield.devices import device
from touchfield.measure.estimators import entropy_bits

if TYPE_CHECKING:
    from touchfield.medium import ForceField, HapticMedium

__all__ = ["EXPERIMENT"]

DEVICE: Final = "tshirt-32x32"

RAW_BITS: Final = np.dtype(np.float32).itemsize * 8

CUTOFFS: Final = {"literal": "literal", "corrected": "nyquist"}

INTRODUCTION: Final = """\
The text copy of the paper that this was read from lost the first column of data, scene 1 as voxels; its heads moved.
What is left is read as object of scene 1, voxel and object of scene 2. The table counts magnitudes, which are 32 bits
raw. An actuator renders the greatest |F| over the depth of the scene behind it, through a low-pass in the plane of
the array: *literal* with the cut-off 2/d of section 3.2 for actuators d apart, *corrected* with 1/(2d), where no
pattern finer than the actuators is felt as a coarser one.

Q is six bits, 63 levels and zero (`{words}`, F_min {f_min:.3g} mN). All {actuators} actuators are counted, so that
the entropies of the first frame are of what it is, without an estimate: plug-in, n = {actuators} for voxel and the
number of actuators with a force for object. A sample of so few cannot have more than log2 n bits.
"""


@dataclass(frozen=True)
class _Found:
    """Of one scene and reading."""

    objects: int
    voxel_bits: float
    object_bits: float
    symbols: int
    later: LaterFrames
    worst: float


def run(inputs: Inputs) -> Finding:
    """Table 2 for scene 1 with four and with seven bodies, and for scene 2."""
    shirt = device(DEVICE)
    q = six_bits(shirt.force_max_n)
    chosen = scenes(inputs)
    steps = Steps(inputs.report, len(READINGS) * len(chosen))
    found = [(scene, {r: _found(scene, r, q, steps, inputs.quick) for r in READINGS}) for scene in chosen]
    actuators = shirt.lattice[0] * shirt.lattice[1] * shirt.panels
    parts = [INTRODUCTION.format(words=q.text, f_min=1e3 * q.force_min_n, actuators=actuators)]
    if inputs.quick:
        parts.append("**A quick trial: few later frames.**\n")
    for scene, both in found:
        parts += [f"### {scene.title}\n", _table(scene, both, q, actuators)]
    checked, identities = identity_table(PRINTED_2, {"scene1": "Scene 1", "scene2": "Scene 2"})
    parts.append(_LATER)
    parts += ["### What the printed figures say of each other\n", checked, _WORDS]
    data = {"scenes": [_data(scene, both) for scene, both in found], "printed_identity": identities}
    return Finding("\n".join(parts), {**data, "filter_bits": q.bits, "raw_bits": RAW_BITS})


_LATER = (
    "Later frames are runs of consecutive ones, the first of which the receiver holds already. Of depth maps "
    "they go "
    "from one map to the next: linear interpolation knows no pixel that either of the two does not know, so "
    "that "
    "much of what is sent is sent in the two frames around each map.\n"
)
_WORDS = (
    "Of 1024 actuators 672 have a force, p = 21/32: the printed 1.9 bits are even less than p H_object, what "
    "the "
    "object alone brings. 64 of 1024 is 1/16.\n"
)


def _found(scene: PaperScene, reading: str, q: PerceptualFilter, steps: Steps, quick: bool) -> _Found:
    from touchfield.pipeline.spec import DEFAULT_F0_N

    medium = _medium(scene, reading)
    first = medium[0]
    forces = _forces(first)
    symbols, counts = np.unique(q.symbols_of(forces), return_counts=True)
    objects = counts[symbols != 0]
    empty = first.grid.voxel_count - int(objects.sum())
    with steps.step() as report:
        asked = (1, scene.cycle_frames) if scene.cycle_frames else (4, 4)
        runs = consecutive_runs(len(medium), *((1, 2) if quick else asked))
        later = later_frames(medium.__getitem__, runs, {q.text: q}, MASK_K, report)
    return _Found(
        int(objects.sum()),
        entropy_bits(np.append(objects, empty)),
        entropy_bits(objects),
        len(objects),
        later[reading, q.text],
        q.worst_error(forces, DEFAULT_F0_N),
    )


def _medium(scene: PaperScene, reading: str) -> HapticMedium:
    from touchfield.pipeline.preparation import prepare
    from touchfield.pipeline.spec import EncodeSpec

    spec = EncodeSpec(device=DEVICE, representation="voxel", mapping="fill", cutoff=CUTOFFS[reading])
    return prepare(scene.scene, spec).medium


def _forces(field: ForceField) -> Any:
    return field.forces_n[field.mask]


def _table(scene: PaperScene, both: dict[str, _Found], q: PerceptualFilter, actuators: int) -> str:
    printed = PRINTED_2[scene.key]
    lost = "lost"
    voxel, entropy = printed.on_device[0], printed.entropy[0]
    literal, corrected = (both[r] for r in READINGS)
    held = ", ".join(percent(one.later.held_share) for one in (literal, corrected))
    worst = ", ".join(percent(one.worst) for one in (literal, corrected))
    on_device = count(printed.on_device[1])
    rows: list[list[Any]] = [
        ["Size (1st frame)", "voxel", "10^12", "10^12", "10^12", "as in table 1"],
        ["", "object", count(printed.nominal[1]), "see table 1", "see table 1", ""],
        ["Device filter (1st frame)", "voxel", lost if voxel is None else count(voxel), *[actuators] * 2,
         "32 x 32"],
        ["", "object", on_device, literal.objects, corrected.objects,
         "actuators whose Q(F) is not zero: how much of the array the scene covers"],
        ["Entropy (1st frame)", "voxel", lost if entropy is None else entropy, f"{literal.voxel_bits:.2f}",
         f"{corrected.voxel_bits:.2f}", "h2(p) + p H_object, exactly"],
        ["", "object", printed.entropy[1], f"{literal.object_bits:.2f}", f"{corrected.object_bits:.2f}",
         f"{literal.symbols} and {corrected.symbols} of 63 levels occur"],
        ["Entropy of later frames", "voxel", 0.8, f"{literal.later.voxel_bits:.3g}",
         f"{corrected.later.voxel_bits:.3g}", f"{corrected.later.frames} frames, mask k = {MASK_K}"],
        ["", "object", 1.6, f"{literal.later.object_bits:.3g}", f"{corrected.later.object_bits:.3g}",
         f"held of the object: {held}; scene and device of the printed figures are not stated"],
        ["Raw storage per sample", "both", "32 bits", *[f"{RAW_BITS} bits"] * 2, "one float"],
        ["Perceptual filter", "both", "6 bits", *[f"{q.bits} bits"] * 2,
         f"63 levels and zero; worst relative error of forces from F_0 on: {worst}"],
    ]  # fmt: skip
    return markdown_table(
        ["row", "representation", "printed", "literal", "corrected", "why they differ"], rows
    )


def _data(scene: PaperScene, both: dict[str, _Found]) -> dict[str, Any]:
    printed = PRINTED_2[scene.key]
    return {
        "scene": scene.name,
        "printed": {"device": printed.on_device, "entropy": printed.entropy},
        **{
            reading: {
                "object_count": one.objects,
                "voxel_bits": one.voxel_bits,
                "object_bits": one.object_bits,
                "symbols": one.symbols,
                "worst_relative_error": one.worst,
                "later_voxel_bits": one.later.voxel_bits,
                "later_object_bits": one.later.object_bits,
                "held_share": one.later.held_share,
                "later_frames": one.later.frames,
            }
            for reading, one in both.items()
        },
    }


EXPERIMENT = Experiment("table2", "Table 2: device and perceptual filters for a device of type 2", run)
