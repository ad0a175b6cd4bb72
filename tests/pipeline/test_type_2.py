"""Type 2 end to end (paper section 5.1, table 2): medium, actuators, perceptual filter, 6-bit
samples, stream.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.sources.video.test_saliency import Drawn, gif, picture

from touchfield.cli.main import _exit_code
from touchfield.codec.paper.body import BodyReader
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.quantisers import weber_ladder, weber_levels
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.segment import FrameKind
from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.medium.stores.npz import read_npz
from touchfield.perception.mask import mask_n
from touchfield.pipeline import compare, encode, prepare
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.scene import Scene
from touchfield.sources.video.saliency import SaliencyScene
from video_makers import write_video

SHIRT = "tshirt-32x32"
K = 0.05
RATIO = (1 + K) / (1 - K)
FRAMES = 9
SIX_BITS = PaperSpec(k=K, nq=6, amplitude="weber", interframe="none")


class RoomSequence(DepthSequence):
    """A slanted wall, and a moving box before it."""

    def __init__(self, count: int = 6) -> None:
        self.name, self.intrinsics, self.rate_hz = "room", Intrinsics(80.0, 80.0, 39.5, 29.5), 25.0
        self.frame_count, self.width, self.height = count, 80, 60

    def depth_m(self, frame: int) -> np.ndarray:
        depth = 2.0 + 0.004 * np.arange(80) + 0.002 * np.arange(60)[:, None]
        depth[15:40, 10 + 6 * frame : 30 + 6 * frame] = 1.6
        return depth.astype(np.float32)


def blob() -> SaliencyScene:
    return SaliencyScene(Drawn([picture(i) for i in range(FRAMES)]), 25.0)


def scenes() -> dict[str, Scene]:
    return {"direct": DepthScene(RoomSequence()), "symbolic": blob()}


# -- the ladder of 6 bits ----------------------------------------------------------------------------------


def test_63_steps_and_a_zero_span_547_to_1() -> None:
    ladder = weber_ladder(K, 3.3, 63)
    table = weber_levels(ladder)
    assert len(table) == 64 and table.levels_n[0] == 0
    assert round(RATIO**63) == 547 and ladder.force_max_n / ladder.force_min_n == pytest.approx(
        RATIO**63, rel=1e-4
    )
    assert ladder.force_max_n == pytest.approx(3.3, rel=1e-6)


@given(st.floats(0.01, 0.05), st.integers(1, 9), st.floats(1e-3, 1e3), st.lists(st.floats(0, 1), max_size=30))
def test_a_ladder_keeps_the_mask_up_to_its_top(k: float, nq: int, top: float, parts: list) -> None:
    amplitudes = (top * np.array([1.0, *parts])).astype(np.float32)
    table = weber_levels(weber_ladder(k, float(amplitudes.max()), 2**nq - 1))
    assert len(table) == 2**nq  # n_q bits a sample
    decoded = table.levels_n[table.encode(amplitudes)]
    is_supported = amplitudes >= table.thresholds_n[0]
    assert (
        is_supported[0]
        and (np.abs(decoded - amplitudes)[is_supported] <= k * amplitudes[is_supported] * (1 + 1e-6)).all()
    )
    assert not decoded[~is_supported].any()


def test_an_empty_ladder_and_ladders_too_long() -> None:
    assert len(weber_levels(weber_ladder(K, 0.0, 63))) == 64
    for k, steps in ((K, 0), (K, 65536), (0.1, 511), (0.5, 63)):  # at 0.1, 511 steps from 1 N end at 3e-45 N
        with pytest.raises(InvalidArgument, match=f"{steps} steps"):
            weber_ladder(k, 1.0, steps)
    assert weber_levels(weber_ladder(0.1, 1e-20, 255)).levels_n[-1] >= 1e-20


def test_arrays_use_all_levels_and_points_as_many_as_k_needs() -> None:
    assert PaperSpec(amplitude="weber").for_device(is_array=True).weber_steps == 63
    assert PaperSpec(amplitude="weber").for_device(is_array=False).weber_steps is None
    assert PaperSpec(nq=4, weber_levels="full").for_device(is_array=False).weber_steps == 15
    assert PaperSpec(weber_levels="needed").for_device(is_array=True).weber_steps is None
    assert PaperSpec().for_device(is_array=True).directions == "octa1"
    with pytest.raises(InvalidArgument, match="255 steps"):
        PaperSpec(k=0.3, nq=8, amplitude="weber").for_device(is_array=True)
    with pytest.raises(InvalidArgument, match="weber_levels"):
        PaperSpec(weber_levels="most")


# -- the complete chain------------------------------------------------------------------------------------


@pytest.mark.parametrize("tag", ["direct", "symbolic"])
def test_six_bits_a_sample_and_every_actuator_within_the_mask(tmp_path: Path, tag: str) -> None:
    scene, path = scenes()[tag], tmp_path / "a.touch"
    spec = EncodeSpec(device=SHIRT, coder="paper", paper=SIX_BITS)
    original = prepare(scene, spec).medium
    done = encode(scene, path, spec)
    with open_file(path) as opened:
        summary = opened.summary()
        assert (summary["tags"], summary["device_type"], summary["grid_shape"]) == ([tag], 2, [32, 32, 1])
        codebook = Codebook.get(summary["directions"])
        for i in range(len(opened.reader.segments)):
            table = BodyReader(opened.reader.read_segment(i), opened.grid, codebook).levels(FrameKind.INTRA)
            assert len(table.levels_n) == 64 == device(SHIRT).levels
            assert math.ceil(math.log2(len(table.levels_n))) == 6
            assert table.levels_n[-1] / table.levels_n[1] == pytest.approx(RATIO**62, rel=1e-4)
        raw_bits = 6 * 32 * 32 * len(opened.medium)
        # empty and repeated actuators take few bits; the file also has a head and code tables
        assert opened.bits.total < raw_bits / 2 and 8 * done.file_bytes < raw_bits
        nonzero = 0
        for frame, decoded in enumerate(opened.medium):
            x, y = (f.to_dense()[:, :, 0] for f in (original[frame], decoded))
            assert not x[..., :2].any() and not y[..., :2].any() and y.min() >= 0
            assert (np.abs(x - y)[..., 2] <= mask_n(x[..., 2], K, summary["f0_n"]) * (1 + 1e-6)).all()
            nonzero += decoded.support_count
        assert nonzero == done.supported_voxels > 200


def test_repeated_actuators_do_not_shrink_the_ladder(tmp_path: Path) -> None:
    """An amplitude that was expected to repeat, but is sent, may be the largest of all."""
    for k, nq in ((0.3, 4), (0.08, 8)):
        spec = EncodeSpec(
            device=SHIRT, coder="paper", paper=PaperSpec(k=k, nq=nq, amplitude="weber", interframe="none")
        )
        path = tmp_path / f"{nq}.touch"
        encode(blob(), path, spec)
        assert compare(blob(), path).meter.mask_violations == 0


def test_the_chain_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, path, field = gif(tmp_path / "a.gif", FRAMES), tmp_path / "a.touch", tmp_path / "a.npz"
    options = f"--device {SHIRT} --coder paper --amplitude weber --nq 6 --k 0.05 --interframe none --json"
    assert _exit_code(["encode", str(source), str(path), *options.split()]) == 0
    assert "Symbolic" in json.loads(capsys.readouterr().out)["notes"][0]
    assert _exit_code(["info", str(path), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info["tags"], info["frames"], info["rate_hz"]) == (["symbolic"], FRAMES, 25.0)
    assert _exit_code(["decode", str(path), str(field)]) == 0
    medium = read_npz(field)
    with open_file(path) as opened:
        assert len(medium) == FRAMES and medium[7] == opened.medium[7]
    capsys.readouterr()
    assert _exit_code(["compare", str(source), str(path), "--no-picture", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mask_violations"] == 0


def test_the_picture_shows_each_actuator(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from PIL import Image

    scene, path = blob(), tmp_path / "a.touch"
    encode(scene, path, EncodeSpec(device=SHIRT, coder="paper", paper=SIX_BITS))
    compared = compare(scene, path)
    compared.draw(tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as drawn:
        assert drawn.width > 1000
        colours = np.asarray(drawn.convert("RGB")).reshape(-1, 3)
    yellow = (254, 232, 56)  # the upper end of the colour scale
    assert (np.abs(colours.astype(int) - yellow).max(axis=1) < 24).sum() > 500


def test_an_ordinary_video_on_the_shirt(tmp_path: Path) -> None:
    pytest.importorskip("av")
    video = write_video(tmp_path / "a.mkv", np.stack([picture(i) for i in range(FRAMES)]), "bgr0")
    for source in (video, blob()):
        encode(
            source,
            tmp_path / f"{type(source).__name__}.touch",
            EncodeSpec(device=SHIRT, coder="paper", paper=SIX_BITS),
        )
    first, second = sorted(tmp_path.glob("*.touch"))
    with open_file(first) as a, open_file(second) as b:
        assert a.summary()["tags"] == ["symbolic"]
        assert all(x == y for x, y in zip(a.medium, b.medium, strict=True))


@pytest.mark.shared
def test_real_depth_on_the_shirt(shared_data: Path, tmp_path: Path) -> None:
    source, path = shared_data / "rgbd_tum_fr1_rpy", tmp_path / "a.touch"
    alone = SourceOptions(world="frames")
    done = encode(
        source, path, EncodeSpec(device=SHIRT, coder="paper", paper=SIX_BITS, frames=(0, 4), source=alone)
    )
    assert 8 * done.file_bytes < 6 * 32 * 32 * 4
    assert compare(source, path).meter.mask_violations == 0
