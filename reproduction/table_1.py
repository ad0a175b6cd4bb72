"""Reproduces table 1 of the paper: sizes, entropies and bits of two scenes for a point device (section 5.1).

Every lattice of the paper is counted at its own size, and none is allocated: by systematic samples of it
(`reproduction.lattice_sample`), and by the volume of bodies with a formula.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from reproduction.experiment import Experiment, Finding, Inputs, markdown_table
from reproduction.perceptual_bits import PerceptualFilter, six_and_twelve, three_times_six
from reproduction.printed_tables import PRINTED_1, identity_table
from reproduction.progress import Steps
from reproduction.section_5_1 import NOMINAL, READINGS, PaperScene, scenes
from reproduction.table_1_counts import MASK_K, NW, STEPS, SceneCounts, counts_of
from reproduction.table_wording import bits, count, counted, percent
from touchfield.devices import device
from touchfield.measure.estimators import binary_entropy_bits

if TYPE_CHECKING:
    from reproduction.lattice_sample import LatticeSample

__all__ = ["EXPERIMENT"]

_WHY_ENTROPY = (
    "18 bits tell apart every direction of a curved surface and every depth below it; 5.2 bits are 37 "
    "equally likely "
    "symbols and 2.3 are five, so that the printed figures are of a coarser Q, which is not stated"
)

RAW_BITS: Final = 3 * np.dtype(np.float32).itemsize * 8

INTRODUCTION: Final = """\
*Literal*: 10^4 samples along each axis of the scene's own box, and the device's lattice over the same box, which
stretches the scene onto the workspace. *Corrected*: both lattices over the workspace of the Phantom Omni, 160 x 120
x 70 mm, in which the scene lies with its aspect kept. Forces are F = min(500 N/m x depth, 3.3 N) along the normal, in
the metres of the hand; the field is sampled, not low-passed (the force is F_0 = 0.05 N at a depth of 0.1 mm, which is
about two samples of 0.055 mm).

No lattice of 10^12 samples is allocated. Counts with ± are estimates: every s-th sample along each axis, from
{starts} random starts, about {per_axis} samples along each axis and start; intervals are of 95 %, by the jackknife
over starts. Bodies are also counted without an estimate, as their volume over that of a cell, which differs from the
number of samples within them by less than the samples at their surface.

Entropies need a Q, and the paper names none but "18 bits". Both readings are here: *3 x 6*, each signed component on
31 levels to each side and zero (`{three}`, F_min {three_mn:.3g} mN); and *6 + 12*, 63 levels of amplitude
and 4002 directions (`{twelve}`, F_min {twelve_mn:.3g} mN). mu: X is uniform over all samples of the lattice
(voxel) or over those where Q(F) is not zero (object). The estimator is that of Chao, Wang and Jost, its interval as
above and widened by the difference of two bias corrections; H_voxel = h2(p) + p H_object holds exactly between them.
"""


def run(inputs: Inputs) -> Finding:
    """Table 1 for scene 1 with four and with seven bodies, and for scene 2."""
    force_max_n = device("phantom-omni").force_max_n
    filters = (three_times_six(force_max_n), six_and_twelve(force_max_n))
    chosen = scenes(inputs)
    steps = Steps(inputs.report, STEPS * len(chosen))
    found = [counts_of(scene, filters, steps, inputs.quick) for scene in chosen]
    parts = [_introduction(found[0].nominal["literal"], filters)]
    if inputs.quick:
        parts.append("**A quick trial: few samples.**\n")
    for one in found:
        tables = (_table(one, filters), _entropy_table(one, filters))
        parts += [f"### {one.scene.title}\n", _object_words(one.scene), *tables]
    checked, identities = identity_table(PRINTED_1, {"scene1": "Scene 1", "scene2": "Scene 2"})
    parts += ["### What the printed figures say of each other\n", checked, _arithmetic()]
    data = {"scenes": [_data(one, filters) for one in found], "printed_identity": identities}
    return Finding("\n".join(parts), data)


def _introduction(sample: LatticeSample, filters: tuple[PerceptualFilter, ...]) -> str:
    three, twelve = filters
    per_axis = -(-NOMINAL // sample.spread[0])
    return INTRODUCTION.format(
        starts=len(sample.held), per_axis=per_axis, three=three.text, twelve=twelve.text,
        three_mn=1e3 * three.force_min_n, twelve_mn=1e3 * twelve.force_min_n,
    )  # fmt: skip


def _object_words(scene: PaperScene) -> str:
    found = scene.segmented()
    if found is None:
        return "The object columns are the bodies; the ground is not felt.\n"
    objects, share = found
    return (
        "The object columns are the support: all behind a known surface is solid. Segmented by steps of "
        "depth, the "
        f"first frame has {objects} objects with {100 * share:.0f} % of its known pixels: whole surfaces; "
        "what is left are small pieces. Segmentation tells the parts of the support apart and hardly makes "
        "it "
        "smaller.\n"
    )


# -- the table of one scene --------------------------------------------------------------------------------


def _table(one: SceneCounts, filters: tuple[PerceptualFilter, ...]) -> str:
    printed = PRINTED_1[one.scene.key]
    lattice = " x ".join(str(n) for n in device("phantom-omni").lattice)
    on_device = one.on_device["literal"].grid.voxel_count
    why_object = _why_objects(one)
    rows = [
        ["Size (1st frame)", "voxel", "10^12", "10^12", "10^12", "10^4 along each axis"],
        [
            "",
            "object",
            count(printed.nominal[1]),
            *(counted(one.nominal[r].count) for r in READINGS),
            why_object,
        ],
    ]
    volume_why = "volume over that of a cell: no estimate"
    if one.by_volume:
        volumes = [count(one.by_volume[r, True]) for r in READINGS]
        rows.append(["", "object, by volume", "", *volumes, volume_why])
    rows += [
        [
            "Device filter (1st frame)",
            "voxel",
            "8·10^9",
            *[count(on_device)] * 2,
            f"{lattice}, 0.055 mm apart",
        ],
        [
            "",
            "object",
            "1.8·10^5" if printed.on_device[1] < 1e6 else count(printed.on_device[1]),
            *(counted(one.on_device[r].count) for r in READINGS),
            "as above",
        ],
    ]
    if one.by_volume:
        volumes = [count(one.by_volume[r, False]) for r in READINGS]
        rows.append(["", "object, by volume", "", *volumes, volume_why])
    ratios = [f"{one.nominal[r].count.value / one.on_device[r].count.value:.1f}" for r in READINGS]
    ratio = printed.nominal[1] / printed.on_device[1]
    why = (
        f"both lattices fill one box: 10^12 over {lattice} is {1e12 / on_device:.1f}; 125 = 5^3 is 10^12 "
        "over 8·10^9"
    )
    rows.append(["nominal over device", "object", f"{ratio:.0f}", *ratios, why])
    for name, one_filter in zip(("3 x 6", "6 + 12"), filters):
        rows += _entropy_rows(one, name, one_filter.text)
    rows += _bit_rows(one, filters)
    return markdown_table(
        ["row", "representation", "printed", "literal", "corrected", "why they differ"], rows
    )


def _entropy_rows(one: SceneCounts, name: str, words: str) -> list[list[str]]:
    printed = PRINTED_1[one.scene.key].entropy
    found = {r: one.on_device[r].entropies(words) for r in READINGS}
    later = {r: one.later[r, words] for r in READINGS}
    held = ", ".join(percent(later[r].held_share) for r in READINGS)
    p = found["corrected"].density.value
    return [
        [
            f"Entropy (1st frame), {name}",
            "voxel",
            f"{printed[0]}",
            *(bits(found[r].voxel) for r in READINGS),
            f"the share of samples with a force is {p:.2g}; the printed pair asks for another, see below",
        ],
        ["", "object", f"{printed[1]}", *(bits(found[r].object) for r in READINGS), _WHY_ENTROPY],
        [
            f"Entropy of later frames, {name}",
            "voxel",
            "0.8",
            *(f"{later[r].voxel_bits:.3g}" for r in READINGS),
            "scene and device of the printed figure are not stated",
        ],
        [
            "",
            "object",
            "1.6",
            *(f"{later[r].object_bits:.3g}" for r in READINGS),
            f"held of the object: {held}",
        ],
    ]


def _bit_rows(one: SceneCounts, filters: tuple[PerceptualFilter, ...]) -> list[list[str]]:
    words = filters[0].text
    per_sample, per_frame = _mapping(one, "literal", words), _mapping(one, "corrected", words)
    plain = " and ".join(f"{f.bits}" for f in filters)
    worst = ", ".join(
        f"{name}: {percent(one.worst[f.text])}" for name, f in zip(("3 x 6", "6 + 12"), filters)
    )
    return [
        ["Raw storage per sample", "both", "96 bits", *[f"{RAW_BITS} bits"] * 2, "three floats of 32 bits"],
        ["Perceptual filter", "both", "18 bits", *[f"{plain} bits"] * 2,
         f"3 x 6 and 6 + 12; worst relative error of forces from F_0 on, {worst}"],
        ["WMR (eq. 2)", "voxel", "", f"{per_sample[0]:.3g}", f"{per_frame[0]:.3g}",
         "literal: bits a sample, which mean nothing where the number of samples changes; corrected: bits a "
         "frame"],
        ["HIL (eq. 3)", "voxel", "", f"{per_sample[1]:.3g}", f"{per_frame[1]:.3g}", "as above"],
    ]  # fmt: skip


def _mapping(one: SceneCounts, reading: str, words: str) -> tuple[float, float]:
    """WMR and HIL of nominal workspace to device; literal of entropies a sample, corrected of a frame."""
    source, shown = (side[reading] for side in (one.nominal, one.on_device))
    h, c = source.entropies(words).voxel.value, shown.entropies(words).voxel.value
    if reading == "corrected":
        h, c = h * source.grid.voxel_count, c * shown.grid.voxel_count
    c = min(c, h)
    return c / h, (h - c) / h


def _why_objects(one: SceneCounts) -> str:
    share = one.nominal["literal"].count.value / one.nominal["literal"].grid.voxel_count
    if one.by_volume:
        return (
            f"our bodies fill {percent(share)} of their box, the paper's 0.0022 %; which bodies in what "
            "workspace "
            "is not stated"
        )
    return (
        f"{percent(share)} of the box lies behind a known surface; which depth maps, and how deep the solid "
        "behind "
        "them is, is not stated"
    )


# -- what the entropies are of -----------------------------------------------------------------------------


def _entropy_table(one: SceneCounts, filters: tuple[PerceptualFilter, ...]) -> str:
    rows = []
    for name, f in zip(("3 x 6", "6 + 12"), filters):
        for lattice, samples in (("nominal", one.nominal), ("device", one.on_device)):
            for r in READINGS:
                h = samples[r].entropies(f.text)
                rows.append([
                    name, lattice, r, bits(h.voxel), bits(h.object), f"{h.density.value:.3g}",
                    f"{h.object.samples:,}", f"{h.object.symbols:,}", "; ".join(h.object.notes),
                ])  # fmt: skip
    later = one.later["corrected", filters[0].text]
    head = ["Q", "lattice", "reading", "H_voxel", "H_object", "p", "n with a force", "symbols seen", "notes"]
    told = (
        f"Later frames: {later.frames} frames in runs of consecutive ones, evenly spaced over the "
        f"{one.scene.scene.frame_count}, after the device filter on 2^{NW} samples along each axis of the "
        "workspace, "
        "each counted whole (plug-in). The first of a run is what the receiver holds; the mask is "
        f"k = {MASK_K}. Literal is eq. 8 on amplitudes, corrected the vector against what the receiver "
        "holds.\n"
    )
    return f"{markdown_table(head, rows)}\n{told}"


def _arithmetic() -> str:
    printed = PRINTED_1["scene1"]
    assert printed.on_device[0] is not None
    samples, voxels = printed.on_device[1], printed.on_device[0]
    payload, support = (
        samples * printed.entropy[1] / 1e6,
        voxels * binary_entropy_bits(samples / voxels) / 1e6,
    )
    side = (printed.nominal[1] / 4) ** (1 / 3)
    return (
        "The printed H_voxel are far above what the printed sizes allow: they are of something else than the "
        "lattice "
        "of the sizes (a dense field, a slice, or a part).\n\n"
        "A floor is not felt in the printed counts: in 10^4 x 10^4 columns a floor of a single sample is "
        "10^8 "
        f"samples, and the printed object of scene 1 has {count(printed.nominal[1])}, as much as four cubes "
        "of "
        f"{side:.0f} samples to a side. It is not felt in ours either.\n\n"
        f"96/18 = {96 / 18:.1f} is what the perceptual filter takes off a sample. The object representation "
        "hides "
        "the map of where its samples lie. For the printed sizes of scene 1 on the device's lattice that map "
        "takes "
        f"V h2(p) = {support:.1f} Mbit as independent samples, beside {payload:.2f} Mbit for what they "
        "hold.\n"
    )


# -- as data -----------------------------------------------------------------------------------------------


def _data(one: SceneCounts, filters: tuple[PerceptualFilter, ...]) -> dict[str, Any]:
    def sides(samples: dict[str, LatticeSample]) -> dict[str, Any]:
        return {r: _sample_data(samples[r], filters) for r in READINGS}

    printed = PRINTED_1[one.scene.key]
    return {
        "scene": one.scene.name,
        "printed": {"nominal": printed.nominal, "device": printed.on_device, "entropy": printed.entropy},
        "nominal": sides(one.nominal),
        "device": sides(one.on_device),
        "object_count_by_volume": one.by_volume
        and {
            f"{reading}, {'nominal' if is_nominal else 'device'}": value
            for (reading, is_nominal), value in one.by_volume.items()
        },
        "later_frames": [
            {
                "reading": reading,
                "quantiser": words,
                "voxel_bits": found.voxel_bits,
                "object_bits": found.object_bits,
                "held_share": found.held_share,
                "frames": found.frames,
            }
            for (reading, words), found in one.later.items()
        ],
        "worst_relative_error": one.worst,
        "raw_bits": RAW_BITS,
        "filter_bits": {f.text: f.bits for f in filters},
        "mapping": {
            name: dict(zip(("wmr", "hil"), _mapping(one, reading, filters[0].text)))
            for name, reading in (("per_sample", "literal"), ("per_frame", "corrected"))
        },
    }


def _sample_data(sample: LatticeSample, filters: tuple[PerceptualFilter, ...]) -> dict[str, Any]:
    found: dict[str, Any] = {"voxels": sample.grid.voxel_count, "object_count": sample.count.summary()}
    for f in filters:
        h = sample.entropies(f.text)
        found[f.text] = {"p": h.density.summary(), "object": h.object.summary(), "voxel": h.voxel.summary()}
    return found


EXPERIMENT = Experiment("table1", "Table 1: device and perceptual filters for a device of type 1", run)
