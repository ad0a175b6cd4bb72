"""Every writer either proves and reports its error bound, or warns.

The tables below name every coder, mode and writer; a new one that is missing here fails a test.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import touchfield as tf
from effect_makers import band, channel, document, effect, keyframe, written
from independent_bound import mask_ratio
from touchfield.cli.main import _exit_code
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import ENTRIES, coder, field_coders, field_encoder
from touchfield.codec.segment import MAX_ERROR_KEYS, MaxError, bound_keys, max_error_keys
from touchfield.codec.touch.spec import EFFORTS, MODES, TouchSpec
from touchfield.errors import UnboundedError
from touchfield.medium import PoseTrack
from touchfield.pipeline import encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.rate_control import Target, encode_to_target
from touchfield.pipeline.spec import EncodeSpec
from touchfield.pipeline.tiles import encode_tiles
from touchfield.render.material import Material
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Sphere
from touchfield.tasks.editing import edit, levels_of_detail, resample_file, splice
from touchfield.tasks.exchange import import_effect
from touchfield.tasks.live import LiveSpec, broadcast, coarse_layer, open_sender
from touchfield.tasks.reduction import reduce_medium
from touchfield.tasks.texture import store_materials

SOURCE = Path(__file__).resolve().parents[2] / "src" / "touchfield"
SPHERE = '[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n'

SPECS: dict[str, EncodeSpec] = {
    **{f"touch, {mode}, {effort}": EncodeSpec(nw=4, touch=TouchSpec(mode=mode, effort=effort))
       for mode in MODES for effort in EFFORTS},
    "touch, F_0 = 0": EncodeSpec(nw=4, touch=TouchSpec(f0_n=0.0)),
    "touch, F_0 = 0, mask-direction": EncodeSpec(nw=4, touch=TouchSpec(f0_n=0.0, mode="mask-direction")),
    "touch, masking": EncodeSpec(nw=4, touch=TouchSpec(masking=0.1, masking_radius_m=0.05)),
    "paper": EncodeSpec(nw=4, coder="paper", paper=PaperSpec(directions="ico1")),
    "paper, dct": EncodeSpec(nw=4, coder="paper", paper=PaperSpec(stage="dct")),
}  # fmt: skip

UNBOUNDED = ("nmse", "paper")


def is_bounded(name: str, is_composed: bool = False) -> bool:
    """Which bounds are known, independently of the code: none for nmse, paper, and summed directions."""
    return not any(word in name for word in UNBOUNDED) and not (is_composed and "direction" in name)


@contextmanager
def caught() -> Iterator[list[str]]:
    """Warnings of unproved bounds."""
    texts: list[str] = []
    with warnings.catch_warnings(record=True) as every:
        warnings.simplefilter("always")
        yield texts
    texts += [str(warning.message) for warning in every if issubclass(warning.category, UnboundedError)]


def assert_reported(keys: dict[str, Any], texts: list[str], bounded: bool) -> None:
    """A bound in words with its largest ratio, or None with a note that was also a warning."""
    if bounded:
        assert keys["error_bound"] and keys["promise_kept"] is True and "error_bound_note" not in keys
        assert 0 <= keys["worst_mask_ratio"] <= 1 and texts == []
    else:
        assert keys["error_bound"] is None and not keys.get("promise_kept")
        assert keys["error_bound_note"].startswith("no error bound is proved: ")
        assert "take --" in keys["error_bound_note"] and keys["error_bound_note"] in texts


def rolling(frames: int = 3) -> tf.HapticMedium:
    """A soft ball that pushes outwards and moves along x."""
    grid = tf.Grid.over_box((-0.04,) * 3, (0.04,) * 3, (16, 16, 16))
    positions_m = np.stack(np.meshgrid(*(grid.axis_m(n) for n in range(3)), indexing="ij"), axis=-1)
    dense = []
    for n in range(frames):
        away = positions_m - np.array([0.004 * n, 0.003, 0.0])
        length = np.linalg.norm(away, axis=-1, keepdims=True)
        dense.append(
            np.minimum(100 * np.clip(0.025 - length, 0, None), 2.0) * away / np.maximum(length, 1e-9)
        )
    return tf.HapticMedium.from_array(np.stack(dense).astype(np.float32), grid, 30.0)


def falling() -> BodyScene:
    """A box that tumbles while it falls onto a ball."""
    t = np.arange(4) / 200
    turns = np.stack([np.cos(4 * t), np.sin(4 * t), 0 * t, 0 * t], axis=1)
    ways = np.stack([0 * t, 0.02 + 0 * t, 0.03 - 4.905 * t**2], axis=1)
    box = Body("box", AnalyticScene((Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.01)),)), PoseTrack(turns, ways))
    ball = Body(
        "ball", AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02),)), PoseTrack.constant(4, (0.0, 0.02, 0.01))
    )
    return BodyScene((box, ball), 200.0)


# -- complete tables --------------------------------------------------------------------------------------

WRITERS = {
    "codec/zarr_codec.py": "test_chunks_of_zarr_report_their_bound",
    "pipeline/segments.py": "test_a_file_reports_its_bound",
    "tasks/editing.py": "test_derived_files_report_their_bound",
    "pipeline/encoding.py": "test_a_file_reports_its_bound",
    "tasks/exchange.py": "test_an_effect_reports_its_bound",
    "tasks/live.py": "test_a_live_stream_reports_its_bound",
    "tasks/live_bodies.py": "",  # bodies of a live stream, as sent: tests/network/test_live_bodies.py
    "tasks/watch.py": "",  # encodes as any scene, and mux warns: tests/tasks/test_watch.py
    "tasks/map.py": "",  # pins in mode "lossless"; a relief is encoded as any scene: tests/maps
    "tasks/plan.py": "",  # encodes frames to count their bytes, and writes nothing
    "pipeline/rate_control.py": "test_a_file_of_a_given_size_reports_its_bound",
    "tasks/texture.py": "test_a_copy_reports_its_bound",
    "tasks/view.py": "",  # encodes for the page that it opens, in mode "mask"
    "network/live.py": "",  # wraps a sent segment of a live stream for decoders of files
    "network/mux.py": "",  # copies a file and warns as it does: tests/network/test_mux.py
    "pipeline/workers.py": "test_a_file_reports_its_bound",  # the same segments: tests/pipeline/test_parts.py
}
"""Modules that write or encode segments, with the test of each."""

_WRITES = re.compile(
    r"\b(TouchWriter|ObjectsEncoder|encode_prepared|write_objects|encode_segment)\(|\bdef mux\("
)


def test_every_module_that_writes_is_in_the_table() -> None:
    found = set()
    for path in SOURCE.rglob("*.py"):
        name = path.relative_to(SOURCE).as_posix()
        is_inside = (
            name.startswith(("cli/", "codec/touch", "codec/paper", "codec/objects", "container"))
            or "registry" in name
        )
        if not is_inside and _WRITES.search(path.read_text()):
            found.add(name)
    assert found == set(WRITERS)
    assert {test for test in WRITERS.values() if test} <= set(globals())


def test_every_coder_and_mode_is_in_the_table() -> None:
    assert {spec.coder for spec in SPECS.values()} == set(field_coders()) == set(ENTRIES) - {"objects"}
    touch = [spec.touch for spec in SPECS.values() if spec.coder == "touch"]
    assert {(touch_spec.mode, touch_spec.effort) for touch_spec in touch} == {
        (mode, effort) for mode in MODES for effort in EFFORTS
    }


def test_a_coder_without_a_rule_guarantees_nothing() -> None:
    for name, spec in SPECS.items():
        rule = coder(spec.coder).bound_rule(spec.coding)
        assert (rule.text is not None) == is_bounded(name) and bool(rule.reason) != is_bounded(name)


# -- parts of the mechanism --------------------------------------------------------------------------------


def test_a_file_has_no_bound_if_one_segment_has_none() -> None:
    bound = MaxError(0.5, 2, (1, 2, 3))
    assert max_error_keys([(0, bound), (8, MaxError(0.75, 1, (4, 5, 6)))])["worst_frame"] == 9
    for segments in ([(0, bound), (8, None)], [(0, None), (8, bound)], [(0, None)], []):
        keys = max_error_keys(segments)
        assert keys == dict.fromkeys(MAX_ERROR_KEYS)
        assert bound_keys(coder("touch").bound_rule(TouchSpec()), keys)["error_bound"] is None


@pytest.mark.parametrize("ratio", [float("nan"), float("inf"), 1.0000001, -0.1])
def test_an_invalid_ratio_is_never_written(ratio: float) -> None:
    with pytest.raises(AssertionError, match="of what is allowed"):
        _ = MaxError(ratio, 0, (0, 0, 0)).rounded_up


@pytest.mark.parametrize(("ratio", "steps"), [(0.0, 0), (1e-9, 1), (0.5, 32768), (1.0, 65535)])
def test_a_ratio_is_rounded_up(ratio: float, steps: int) -> None:
    assert MaxError(ratio, 0, (0, 0, 0)).rounded_up == steps


# -- writers -----------------------------------------------------------------------------------------------


def keys_of(path: Path) -> dict[str, Any]:
    """The error bound as stated in the file."""
    with open_file(path) as opened:
        return opened.error_bound()


def assert_same(summary: dict[str, Any], path: Path) -> None:
    """A summary states the same as the file."""
    stated = keys_of(path)
    assert {name: summary[name] for name in stated} == stated


@pytest.mark.parametrize("name", SPECS)
def test_a_file_reports_its_bound(name: str, tmp_path: Path) -> None:
    spec, out = SPECS[name], tmp_path / "a.touch"
    medium = rolling()
    with caught() as texts:
        done = encode(medium, out, spec)
    assert_reported(done.summary(), texts, is_bounded(name))
    assert_same(done.summary(), out)
    if spec.touch.mode == "mask" and spec.coder == "touch" and not spec.touch.masking:
        with open_file(out) as opened:
            pairs = [(a.to_dense(), b.to_dense()) for a, b in zip(medium, opened.medium, strict=True)]
        ratio = max(mask_ratio(a, b, spec.k, spec.f0_n) for a, b in pairs)
        assert ratio <= done.summary()["worst_mask_ratio"] <= ratio + 1e-4


@pytest.mark.parametrize("name", ["touch, mask, fast", "touch, nmse, fast"])
def test_a_file_written_by_workers_reports_its_bound(name: str, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(SPHERE)
    with ThreadPoolExecutor(1) as executor, caught() as texts:
        done = encode(tmp_path / "a.toml", tmp_path / "a.touch", SPECS[name], executor=executor)
    assert_reported(done.summary(), texts, is_bounded(name))
    assert_same(done.summary(), tmp_path / "a.touch")


@pytest.mark.parametrize("damping", [0.0, 1.0])
@pytest.mark.parametrize("name", [name for name in SPECS if "masking" not in name])
def test_bodies_report_their_bound(name: str, damping: float, tmp_path: Path) -> None:
    spec, out = replace(SPECS[name], surface_damping_n_s_per_m=damping), tmp_path / "a.touch"
    with caught() as texts:
        done = encode(falling(), out, spec)
    with open_file(out) as opened:
        assert opened.scene is not None
    assert_reported(done.summary(), texts, is_bounded(name, is_composed=True))
    assert_same(done.summary(), out)


@pytest.mark.parametrize("name", ["touch, mask, fast", "touch, lossless, fast", "touch, nmse, fast", "paper"])
def test_derived_files_report_their_bound(name: str, tmp_path: Path) -> None:
    spec, source = SPECS[name], tmp_path / "a.touch"
    with caught():
        encode(rolling(), source, spec)
    outs = {
        "edit": lambda out: edit(source, out, operators=["gain:0.5"], spec=spec),
        "splice": lambda out: splice([str(source), f"{source}@1:2"], out, spec=spec),
        "resample": lambda out: resample_file(source, out, (3, None, None), spec=spec),
        "reduce": lambda out: reduce_medium(source, out, coder=spec),
    }
    for way, run in outs.items():
        out = tmp_path / f"{way}.touch"
        with caught() as texts:
            summary = run(out).summary()
        assert_reported(summary, texts, is_bounded(name))
        assert_same(summary, out)
    with caught() as texts:
        culled = reduce_medium(source, None, tmp_path / "culled.touch", coder=spec).summary()
    assert_reported(
        {key[7:]: value for key, value in culled.items() if key.startswith("culled_")},
        texts,
        is_bounded(name),
    )
    with caught() as texts:
        levels_of_detail(source, tmp_path / "levels", 1, spec=spec)
    for level in range(2):
        assert_reported(keys_of(tmp_path / "levels" / f"level-{level}.touch"), texts, is_bounded(name))


@pytest.mark.parametrize("name", ["touch, mask, fast", "touch, nmse, fast"])
def test_a_file_of_a_given_size_reports_its_bound(name: str, tmp_path: Path) -> None:
    with caught() as texts:
        done = encode_to_target(rolling(), tmp_path / "a.touch", SPECS[name], Target(nmse_db=-25.0))
    assert_reported(done.summary(), texts, is_bounded(name))
    assert_same(done.summary(), tmp_path / "a.touch")


@pytest.mark.parametrize("name", ["touch, mask, fast", "touch, nmse, fast", "paper"])
def test_an_effect_reports_its_bound(name: str, tmp_path: Path) -> None:
    wave = band("VectorialWave", effect([keyframe(0, 0.5, 100), keyframe(100, 0.5, 200)]))
    source = written(tmp_path / "e.hjif", document(channel(wave)))
    with caught() as texts:
        done = import_effect(source, tmp_path / "e.touch", replace(SPECS[name], nw=None), force_max_n=2.0)
    assert_reported(done.summary(), texts, is_bounded(name))


@pytest.mark.parametrize("name", ["touch, mask, fast", "touch, mask-direction, fast", "touch, nmse, fast"])
def test_a_live_stream_reports_its_bound(name: str) -> None:
    with caught() as texts:
        prepared, sender = open_sender(rolling(), replace(SPECS[name], nw=None))
        coarse, under = coarse_layer(rolling(), prepared)
        sent = broadcast(prepared, sender.add, LiveSpec(), pause=lambda s: None, coarse=(coarse, under.add))
    keys = {**sent.error_bound(prepared), **sent.summary()}
    assert sent.segments and coarse.spec.touch.mode == "mask"
    assert_reported(keys, texts, is_bounded(name))


@pytest.mark.parametrize("name", ["touch, mask, fast", "touch, nmse, fast"])
def test_chunks_of_zarr_report_their_bound(name: str, tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="the extra zarr is not installed", exc_type=Exception)
    from touchfield.codec.zarr_codec import TouchCodec, recorded_ratios

    (tmp_path / "a.toml").write_text(SPHERE)
    with caught() as texts:
        done = encode_tiles(tmp_path / "a.toml", tmp_path / "a.zarr", SPECS[name])
    assert done.supported_voxels and done.tiles == 1
    assert_reported(done.summary(), texts, is_bounded(name))
    dense = np.stack([field.to_dense() for field in rolling()])
    with caught() as texts, recorded_ratios() as ratios:
        TouchCodec(mode=SPECS[name].touch.mode).encode_chunk(dense)
    assert (texts == []) == (ratios != [None]) == is_bounded(name)


@pytest.mark.parametrize("name", ["touch, mask, fast", "touch, nmse, fast"])
def test_a_copy_reports_its_bound(name: str, tmp_path: Path) -> None:
    source, out = tmp_path / "a.touch", tmp_path / "b.touch"
    with caught():
        encode(rolling(), source, SPECS[name])
    with caught() as texts:
        store_materials(source, [Material("oak", 0.3)], out)
    assert_reported(keys_of(out), texts, is_bounded(name))
    assert keys_of(out) == keys_of(source)


# -- on the command line -----------------------------------------------------------------------------------


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[str, str]:
    capsys.readouterr()
    assert _exit_code([str(word) for word in arguments]) == 0
    captured = capsys.readouterr()
    return captured.out, captured.err


@pytest.mark.parametrize(
    ("options", "bounded"), [("", True), ("--f0-n 0", True), ("--mode nmse", False), ("--coder paper", False)]
)
def test_commands_print_the_bound_or_warn(
    options: str, bounded: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = tmp_path / "a.toml", tmp_path / "a.touch"
    scene.write_text(SPHERE)
    for arguments in (("encode", scene, out, "--nw", 4, *options.split()), ("info", out)):
        stdout, stderr = run(capsys, *arguments)
        assert "error_bound " in stdout and ("warning: no error bound" in stderr) == (not bounded)
        stdout, stderr = run(capsys, *arguments, "--json")
        answer = json.loads(stdout)
        assert ("warning: no error bound" in stderr) == (not bounded)
        assert bool(answer["error_bound"]) == bounded and answer.get("warnings", []) == (
            [] if bounded else [answer["error_bound_note"]]
        )


# -- numbers for people ------------------------------------------------------------------------------------


def test_no_field_stops_an_encoding_by_its_statistics() -> None:
    """Small and repetitive fields that take fewer bits than estimated."""
    for shape in ((1, 1, 1), (2, 1, 1), (4, 4, 4)):
        grid = tf.Grid(shape, (0.001,) * 3, (0.0,) * 3)
        for seed in range(30):
            rng = np.random.default_rng(seed)
            frames = np.repeat(rng.normal(size=(1, *shape, 3)), 6, axis=0).astype(np.float32)
            frames[:, rng.random(shape) < 0.3] = (1, 0, 0)
            encoder = field_encoder(grid, TouchSpec(mode="lossless"))
            encoder.encode_segment([tf.ForceField.from_dense(grid, f) for f in frames])


def test_f0_of_bodies_is_zero_in_the_file(tmp_path: Path) -> None:
    """The encoder of bodies needs an F_0 for their poses; the F_0 of the bound is that of the mask."""
    encoder = ObjectsEncoder(tf_scene := prepared_scene(), TouchSpec(f0_n=0.0), 0.05)
    assert encoder.is_bounded and len(list(encoder.segments())) >= 1 and len(tf_scene) == 4


def prepared_scene() -> tf.medium.HapticScene:
    """The bodies of `falling` as a haptic scene."""
    scene = tf.prepare(falling(), EncodeSpec(nw=4)).objects
    assert scene is not None
    return scene
