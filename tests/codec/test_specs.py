"""Options of the field coders: their ranges, defaults per device, and the text of each guarantee."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from touchfield.codec.objects.encoder import Damping, ObjectsEncoder, choose_pose_steps
from touchfield.codec.objects.layout import Parameters, composed_rule
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import coder
from touchfield.codec.segment import BitAccount, compression_ratio
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import MODES, TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack

GRID = Grid((20, 9, 12), (0.001, 0.002, 0.003), (0.1, 0.2, 0.3))
TOUCH, PAPER = coder("touch"), coder("paper")


def noise(seed: int = 0, size_n: float = 1.0, density: float = 0.5) -> ForceField:
    rng = np.random.default_rng(seed)
    forces = size_n * rng.normal(size=(*GRID.shape, 3)) * (rng.random((*GRID.shape, 1)) < density)
    return ForceField.from_dense(GRID, forces.astype(np.float32))


# -- ranges
# ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "fits", "wrong"),
    [
        ("k", (0.001, 0.999), (0.00099, 1.0, math.nan)),
        ("f0_n", (0.0, 1e9), (-1e-9, math.inf, math.nan)),
        ("step_n", (1e-9, 1e9), (0.0, math.inf, math.nan)),
        ("direction_jnd_deg", (1e-3, 89.9), (0.0, 90.0, math.nan)),
        ("segment_frames", (1, 4096), (0, 4097)),
        ("masking", (0.0, 1.0), (-0.01, 1.01, math.nan)),
        ("masking_radius_m", (1e-6, 1.0), (9e-7, 1.01, math.nan)),
    ],
)
def test_ranges_of_the_touch_coder_include_their_limits(
    name: str, fits: tuple[Any, ...], wrong: tuple[Any, ...]
) -> None:
    for value in fits:
        assert getattr(TouchSpec(**{name: value}), name) == value
    for value in wrong:
        with pytest.raises(InvalidArgument, match=f"^{name}: found {value}"):
            TouchSpec(**{name: value})


@pytest.mark.parametrize(
    ("name", "fits", "wrong"),
    [
        ("k", (1e-4, 0.999), (0.0, 1.0, math.nan)),
        ("nq", (1, 12), (0, 13)),
        ("segment_frames", (1, 4096), (0, 4097)),
        ("step_n", (), (9e-10, 1.1e6, math.nan)),
    ],
)
def test_ranges_of_the_paper_coder_include_their_limits(
    name: str, fits: tuple[Any, ...], wrong: tuple[Any, ...]
) -> None:
    for value in fits:
        assert getattr(PaperSpec(**{name: value}), name) == value
    for step_n in (1e-9, 1e6):
        assert PaperSpec(stage="dct", step_n=step_n).step_n == step_n
    for value in wrong:
        with pytest.raises(InvalidArgument, match=f"^{name}: found {value}"):
            PaperSpec(**{name: value})


def test_options_that_a_stage_ignores_or_needs_are_refused() -> None:
    assert PaperSpec(stage="runs", k=0.2, segment_frames=3, step_n=0.1)
    idle = {"nq": 5, "directions": "ico3", "amplitude": "weber", "deadband": "none", "interframe": "none",
            "choose_by_size": False, "hold_runs": False, "weber_levels": "full"}  # fmt: skip
    for name, value in idle.items():
        assert PaperSpec(**{name: value})
        with pytest.raises(
            InvalidArgument, match=rf"^{name}: found it with stage dct; expected it without a stage"
        ):
            PaperSpec(stage="dct", **{name: value})
    with pytest.raises(
        InvalidArgument, match=r"^step_n: found it with stage none; expected it with a stage only"
    ):
        PaperSpec(step_n=0.1)


@pytest.mark.parametrize(
    ("is_array", "directions", "levels", "steps"),
    [(False, "ico5", "needed", None), (True, "octa1", "full", 31)],
)
def test_auto_options_depend_on_the_device(
    is_array: bool, directions: str, levels: str, steps: int | None
) -> None:
    found = PAPER.resolve(PaperSpec(nq=5), is_array)
    assert (found.directions, found.weber_levels, found.weber_steps) == (directions, levels, steps)
    explicit = PaperSpec(directions="ico3", weber_levels="needed")
    assert explicit.for_device(is_array) == explicit
    staged = PaperSpec(stage="dct")
    assert staged.for_device(is_array) == staged
    assert TOUCH.resolve(TouchSpec(), is_array) == TouchSpec()


def test_printed_name_of_the_coder() -> None:
    printed = PAPER.makers["paper-literal"]({"k": 0.2, "nq": 4})
    assert printed == PaperSpec(
        k=0.2,
        nq=4,
        directions="octa3",
        deadband="previous",
        interframe="open",
        choose_by_size=False,
        hold_runs=False,
    )
    assert PAPER.makers["paper-literal"]({"deadband": "zero"}).deadband == "zero"
    assert PAPER.makers["paper"]({"k": 0.2}) == PaperSpec(k=0.2)


# -- options together
# -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "spec"),
    [
        ({}, TouchSpec()),
        ({"lossless_quantised": True}, TouchSpec(mode="lossless")),
        ({"lossless_quantised": False, "k": 0.2}, TouchSpec(k=0.2)),
        ({"lossless_quantised": True, "segment_frames": 5}, TouchSpec(mode="lossless", segment_frames=5)),
        ({"target_nmse_db": -30.0}, TouchSpec(mode="nmse")),
        ({"target_nmse_db": -30.0, "mode": "mask"}, TouchSpec()),
        ({"target_nmse_db": None}, TouchSpec()),
        ({"target_nmse_db": -30.0, "step_n": 0.1}, TouchSpec(mode="nmse", step_n=0.1)),
        ({"masking": 0.2, "body_site": "belly"}, TouchSpec(masking=0.2, masking_radius_m=0.03)),
        ({"masking": 0.2}, TouchSpec(masking=0.2, masking_radius_m=0.0025)),
        (
            {"mode": "mask-direction", "direction_jnd_deg": 20.0},
            TouchSpec(mode="mask-direction", direction_jnd_deg=20),
        ),
    ],
)
def test_options_make_a_spec(options: dict[str, Any], spec: TouchSpec) -> None:
    if "body_site" in options:
        from touchfield.perception.mask import site_radius_m

        spec = replace(spec, masking_radius_m=site_radius_m(options["body_site"]))
        assert spec.masking_radius_m != 0.0025
    assert TOUCH.makers["touch"](options) == spec


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lossless_quantised": True, "mode": "mask"}, "--mode: found it together with --lossless-quantised"),
        ({"lossless_quantised": True, "f0_n": 0.1}, "--f0-n: found it together"),
        ({"lossless_quantised": True, "support": "exact"}, "--support: found it together"),
        ({"body_site": "palm"}, "--body-site: found it without --masking"),
        ({"body_site": "palm", "masking": 0.0}, "--body-site: found it without --masking"),
        ({"step_n": 0.1}, "--step-n: found it in mode mask; expected it in mode nmse only"),
        ({"direction_jnd_deg": 9.0, "mode": "nmse"}, "--direction-jnd-deg: found it in mode nmse; expected"),
    ],
)  # fmt: skip
def test_contradictory_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        TOUCH.makers["touch"](options)


# -- words
# ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        (TouchSpec(k=0.2, f0_n=0.03), "|error| <= max(0.03 N, 0.2 |F|) at every voxel of every frame"),
        (TouchSpec(k=0.2, f0_n=0.0), "|error| <= 0.2 |F| at every voxel of every frame"),
        (
            TouchSpec(k=0.2, f0_n=0.03, masking=0.4, masking_radius_m=0.007),
            "|error| <= max(0.03 N, 0.2 |F| + 0.4 of the mean force within 7 mm) at every voxel of every "
            "frame",
        ),
        (
            TouchSpec(k=0.2, f0_n=0.03, mode="mask-direction", direction_jnd_deg=17.5),
            "the length within max(0.03 N, 0.2 |F|) and the direction within 17.5 degrees "
            "where |F| > 0.03 N / sin(17.5 degrees), elsewhere |error| <= 0.03 N",
        ),
        (TouchSpec(mode="lossless"), "every force bit for bit"),
        (TouchSpec(mode="nmse"), None),
        (PaperSpec(), None),
    ],
)
def test_guarantee_of_each_mode_states_its_numbers(spec: Any, text: str | None) -> None:
    rule = (TOUCH if isinstance(spec, TouchSpec) else PAPER).bound_rule(spec)
    assert rule.text == text
    reasons = {
        TouchSpec: "mode nmse keeps a mean squared error, which bounds no single voxel; take --mode mask",
        PaperSpec: "coder paper bounds the error of no voxel; take --coder touch",
    }
    assert rule.reason == ("" if text else reasons[type(spec)])


def test_guarantee_of_composed_bodies_states_its_numbers() -> None:
    masked = TOUCH.bound_rule(TouchSpec(k=0.2, f0_n=0.03))
    suffix = "with every body within 12.5 um of its place"
    undamped, damped = Parameters(2, 0.0, 12.5e-6), Parameters(2, 0.5, 12.5e-6)
    assert (
        composed_rule(("lossless",), masked, undamped).text
        == f"every force of every body bit for bit, {suffix}"
    )
    for modes, parameters in (
        (("lossless",), damped),
        (("mask",), undamped),
        (("mask", "lossless"), undamped),
    ):
        assert composed_rule(modes, masked, parameters).text == f"{masked.text}, {suffix}"
    for mode, remedy in (
        ("nmse", "take --mode mask"),
        ("mask-direction", "take --mode mask or --representation voxel"),
    ):
        rule = composed_rule(("mask", mode), masked, undamped)
        reason = f"mode {mode} bounds no force that several bodies have together; {remedy}"
        assert (rule.text, rule.reason) == (None, reason)


def test_summary_has_the_relevant_options() -> None:
    assert TOUCH.summary(TouchSpec(effort="fast")) == {"mode": "mask", "effort": "fast"}
    assert TOUCH.summary(TouchSpec(masking=0.2))["masking"] == 0.2
    assert TOUCH.summary(TouchSpec(mode="nmse", step_n=0.3)) == {
        "mode": "nmse",
        "effort": "default",
        "step_n": 0.3,
    }
    assert PAPER.summary(PaperSpec()) == {} and PAPER.summary(PaperSpec(stage="dct")) == {"stage": "dct"}


# -- accounts
# -------------------------------------------------------------------------------------------------------


def test_bit_accounts_add_by_part() -> None:
    first, second = BitAccount(1, 20, 300, 4000, 50_000, 600_000), BitAccount(7, 6, 5, 4, 3, 2)
    assert first + second == BitAccount(8, 26, 305, 4004, 50_003, 600_002)
    assert first.total == 654_321 and BitAccount().total == 0
    assert compression_ratio(96.0, 3, 5) == pytest.approx(1 / 15)


@pytest.mark.parametrize("stage", ["none", "dct", "runs"])
def test_the_bits_of_the_paper_s_coder_are_those_of_its_bytes(stage: str) -> None:
    spec = PaperSpec(stage=stage, **({"segment_frames": 3} if stage == "none" else {"step_n": 0.1}))
    frames = [noise(), noise(0, 1.01), noise(3)]
    segment = PaperEncoder(GRID, spec).encode_segment(frames)
    assert [record.supported for record in segment.frames] == [frame.support_count for frame in frames]
    assert all(0 < record.sent <= record.supported for record in segment.frames)
    assert sum(record.bits.total for record in segment.frames) <= 8 * len(segment.body)
    decoder = PAPER.decoder_class(GRID, PaperEncoder(GRID, spec).parameters)
    assert [record.bits for record in decoder.costs(segment.body, 3)] == [
        record.bits for record in segment.frames
    ]


# -- segments of the touch coder
# ------------------------------------------------------------------------------------


def decode_fields(spec: TouchSpec, body: bytes, count: int) -> list[ForceField]:
    return list(TouchDecoder(GRID, TouchEncoder(GRID, spec).parameters).frames(body, count))


@pytest.mark.parametrize("mode", ["mask", "mask-direction", "nmse"])
def test_exact_samples_leave_the_others_unchanged(mode: str) -> None:
    spec = TouchSpec(mode=mode)
    encoder, frames = TouchEncoder(GRID, spec), [noise(), noise(0, 1.01), noise(3)]
    segment = encoder.encode_segment(frames)
    rng = np.random.default_rng(1)
    bricks = int(np.prod(GRID.brick_shape))
    samples_sorted = np.sort(rng.choice(512 * bricks, 40, replace=False))
    local = np.stack(np.unravel_index(samples_sorted % 512, (8, 8, 8)), axis=-1)
    positions = 8 * np.stack(np.unravel_index(samples_sorted // 512, GRID.brick_shape), axis=-1) + local
    inside = (positions < GRID.shape).all(axis=1)
    samples_sorted, positions = samples_sorted[inside], positions[inside]
    samples = [samples_sorted, np.zeros(0, np.int64), samples_sorted[-1:]]
    amended = encoder.with_exact_samples(segment, frames, samples)
    before, after = decode_fields(spec, segment.body, 3), decode_fields(spec, amended.body, 3)
    changed = 0
    for source, old, new, exact in zip(frames, before, after, samples, strict=True):
        expected = old.to_dense().copy()
        at = tuple(positions[np.isin(samples_sorted, exact)].T)
        expected[at] = source.to_dense()[at]
        np.testing.assert_array_equal(new.to_dense(), expected)
        changed += int((expected != old.to_dense()).any())
    assert changed == 2
    assert (amended.max_error is None) == (mode == "nmse")


def test_lossless_segment_needs_no_exact_samples() -> None:
    encoder, frames = TouchEncoder(GRID, TouchSpec(mode="lossless")), [noise()]
    with pytest.raises(InvalidArgument, match="exact samples: found them in mode lossless"):
        encoder.with_exact_samples(encoder.encode_segment(frames), frames, [np.zeros(1, np.int64)])


@pytest.mark.parametrize("size_n", [0.01, 5.0])  # below the floor, and above it
def test_key_frame_is_reused_while_the_scene_is_static(size_n: float) -> None:
    spec = TouchSpec(k=0.1, f0_n=0.05)
    encoder, force = TouchEncoder(GRID, spec), np.array([0.0, 0.0, size_n])
    before = ForceField.from_support(GRID, [[3, 4, 5], [19, 8, 11]], [force, force])
    allowed_n = max(0.02 * spec.f0_n, 0.002 * size_n)  # 2 % of the mask
    for fraction, is_reused in ((0.99, True), (1.01, False)):
        last = force + np.array([fraction * allowed_n, 0, 0])
        frame = ForceField.from_support(GRID, [[3, 4, 5], [19, 8, 11]], [force, last])
        assert (encoder.key_frame(frame, before) is before) == is_reused
        assert (encoder.key_frame(frame, before) is frame) != is_reused
    assert encoder.key_frame(before, None) is before
    for mode in set(MODES) - {"mask", "mask-direction"}:
        frame = before.scaled(1.0)
        assert TouchEncoder(GRID, TouchSpec(mode=mode)).key_frame(frame, before) is frame


def test_errors_name_the_frame_that_cannot_be_coded() -> None:
    encoder = TouchEncoder(GRID, TouchSpec())
    other = ForceField.empty(Grid((20, 9, 13), GRID.spacing_m, GRID.origin_m))
    with pytest.raises(InvalidArgument, match=r"frame 1: found a grid of \(20, 9, 13\)"):
        encoder.encode_segment([noise(), other])
    with pytest.raises(InvalidArgument, match=r"frame 1: found a grid of \(20, 9, 13\)"):
        encoder.encode_segment(iter([noise(), other]), longest_n=9.0)
    with pytest.raises(InvalidArgument, match=r"frame 2: found a force of 1\.5e\+37 N"):
        encoder.encode_segment(
            [noise(), noise(), ForceField.from_support(GRID, [[0, 0, 0]], [[1.5e37, 0, 0]])]
        )
    with pytest.raises(
        InvalidArgument, match=r"frame 1: found a force of 2e\+06 N; expected finite newtons, 1e\+06"
    ):
        PaperEncoder(GRID, PaperSpec()).encode_segment(
            [noise(), ForceField.from_support(GRID, [[0, 0, 0]], [[2e6, 0, 0]])]
        )


# -- bodies
# ---------------------------------------------------------------------------------------------------------


def test_error_of_too_fine_poses_states_tolerance_and_damping() -> None:
    track = PoseTrack(PoseTrack.constant(3).quaternions, np.array([[0.0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]]))
    message = r"poses that keep to 20 um, and a damping of 7 N s/m at 1000 Hz"
    with pytest.raises(InvalidArgument, match=message):
        choose_pose_steps(track, 0.03, 2e-5, Damping(7.0, 1000.0, 0.0))
    assert choose_pose_steps(track, 0.03, 2e-5, Damping(0.0, 1000.0, 0.0))


def test_masking_of_bodies_is_refused() -> None:
    body = HapticObject("a", HapticMedium.from_frames([noise()], 30.0), PoseTrack.constant(2))
    scene = HapticScene(GRID, 30.0, (body,), 3.3, surface_damping_n_s_per_m=0.25)
    with pytest.raises(
        InvalidArgument, match="--masking: found it with bodies that have fields of their own"
    ):
        ObjectsEncoder(scene, TouchSpec(masking=0.1), 0.05)
    encoder = ObjectsEncoder(scene, TouchSpec(), 0.05)
    assert Parameters(1, 0.25, 1e-5).to_bytes() == encoder.parameters
    assert encoder.is_bounded and not ObjectsEncoder(scene, TouchSpec(mode="nmse"), 0.05).is_bounded
    assert not ObjectsEncoder(scene, PaperSpec(), 0.05).is_bounded
