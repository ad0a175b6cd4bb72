"""A single depth or disparity map as a source."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

import depth_makers as make
from touchfield.errors import MissingExtra, SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth import inverse_depth
from touchfield.sources.depth.layouts import LAYOUTS
from touchfield.sources.options import SourceOptions

depth_map = LAYOUTS[5]


# -- one picture -------------------------------------------------------------------------------------------


def test_a_depth_map_of_each_kind(tmp_path: Path) -> None:
    mm = make.depths_mm()[0]
    metres = (mm / 1000).astype(np.float32)
    np.save(tmp_path / "depth.npy", metres)
    Image.fromarray(metres).save(tmp_path / "depth.tif")
    make.write_png(tmp_path / "my_depth.png", mm)
    for name, scale in (("depth.npy", None), ("depth.tif", None), ("my_depth.png", 1000.0)):
        options = SourceOptions(intrinsics="20,21,5.5,4", depth_scale=scale)
        assert depth_map.kind.recognise(tmp_path / name)
        sequence = depth_map.read_sequence(tmp_path / name, options)
        assert sequence.frame_count == 1
        assert np.allclose(sequence.depth_m(0), metres)
    assert not depth_map.kind.recognise(make.write_png(tmp_path / "heights.png", mm))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (SourceOptions(intrinsics="20,21,5.5,4"), "--depth-scale"),
        (SourceOptions(depth_scale=1000), "--intrinsics fx,fy,cx,cy"),
    ],
)
def test_error_of_a_depth_map_names_the_missing_options(
    tmp_path: Path, options: SourceOptions, message: str
) -> None:
    path = make.write_png(tmp_path / "depth.png", make.depths_mm()[0])
    with pytest.raises(SourceError, match=rf"depth\.png.*{message}"):
        depth_map.read_sequence(path, options)
    with pytest.raises(SourceError, match="depth-folder"):
        depth_map.read_sequence(tmp_path, options)


# -- disparity ---------------------------------------------------------------------------------------------

RIG = SourceOptions(intrinsics="100,100,5.5,4", baseline_m=0.2, disparity_offset_px=2.0)


def _disparities() -> tuple[np.ndarray, np.ndarray]:
    """Disparities in pixels, and their depths in metres with `RIG`."""
    disparity_px = (
        np.linspace(2, 40, make.WIDTH * make.HEIGHT).reshape(make.HEIGHT, make.WIDTH).astype(np.float32)
    )
    disparity_px = np.round(disparity_px * 256) / 256
    depth = 100 * 0.2 / (disparity_px + 2.0)
    disparity_px[0, :3], depth[0, :3] = (0, 0, 0), 0
    return disparity_px.astype(np.float32), depth


def test_a_disparity_map_in_each_format(tmp_path: Path) -> None:
    disparity_px, depth = _disparities()
    np.save(tmp_path / "disp.npy", np.where(disparity_px == 0, np.inf, disparity_px))
    make.write_pfm(tmp_path / "disp.pfm", np.where(disparity_px == 0, np.inf, disparity_px))
    make.write_pfm(tmp_path / "disp_big.pfm", disparity_px, ">")
    make.write_png(tmp_path / "disp.png", np.round(disparity_px * 256).astype(np.uint16))
    for name in ("disp.npy", "disp.pfm", "disp_big.pfm", "disp.png"):
        assert inverse_depth.KINDS["disparity"].recognise(tmp_path / name)
        sequence = inverse_depth.read_disparity(tmp_path / name, RIG)
        read = sequence.depth_m(0)
        assert read.dtype == np.float32 and read.flags.writeable
        assert np.allclose(read, depth, rtol=1e-6)
        assert np.array_equal(read == 0, depth == 0)


def test_middlebury_calibration_next_to_the_map_is_used(tmp_path: Path) -> None:
    disparity_px, depth = _disparities()
    path = make.write_pfm(tmp_path / "disp0.pfm", disparity_px)
    calibration = (
        "cam0=[100 0 5.5; 0 100 4; 0 0 1]\ncam1=[100 0 7.5; 0 100 4; 0 0 1]\n"
        "doffs=2\nbaseline=200\nwidth=12\nheight=9\nndisp=60\n"
    )
    (tmp_path / "calib.txt").write_text(calibration)
    sequence = inverse_depth.read_disparity(path, SourceOptions())
    assert sequence.intrinsics == Intrinsics(100, 100, 5.5, 4)
    assert sequence.notes == ("Camera and baseline are those of calib.txt, unless given as options.",)
    named = inverse_depth.read_disparity(path, SourceOptions(intrinsics="200,210,5.5,4"))
    assert named.intrinsics == Intrinsics(200, 210, 5.5, 4) and np.allclose(
        named.depth_m(0), 2 * depth, rtol=1e-6
    )
    assert np.allclose(sequence.depth_m(0), depth, rtol=1e-6)
    other = inverse_depth.read_disparity(path.rename(tmp_path / "disp1.pfm"), SourceOptions(baseline_m=0.4))
    assert other.intrinsics.cx == 7.5
    assert np.allclose(other.depth_m(0), 2 * depth, rtol=1e-6)
    is_known = depth > 0  # without the offset of 2 pixels, and with disparities in halves
    options = SourceOptions(disparity_offset_px=0.0, depth_scale=2.0)
    halved = inverse_depth.read_disparity(tmp_path / "disp1.pfm", options).depth_m(0)
    assert np.allclose(halved[is_known], 100 * 0.2 / (disparity_px[is_known] / 2), rtol=1e-6)
    for bad in (
        calibration.replace("width=12", "width=13"),
        calibration.replace("baseline=200", "baseline=-1"),
        "x",
    ):
        (tmp_path / "calib.txt").write_text(bad)
        with pytest.raises(SourceError, match=r"calib\.txt"):
            inverse_depth.read_disparity(tmp_path / "disp1.pfm", SourceOptions())


def test_a_disparity_map_cut_anywhere_is_a_source_error(tmp_path: Path) -> None:
    data = make.write_pfm(tmp_path / "disp.pfm", _disparities()[0]).read_bytes()
    for length in range(0, len(data), 3):
        (tmp_path / "disp.pfm").write_bytes(data[:length])
        with pytest.raises(SourceError, match="disp"):
            inverse_depth.read_disparity(tmp_path / "disp.pfm", RIG)


def test_errors_of_a_disparity_map_name_the_missing_options(tmp_path: Path) -> None:
    disparity_px, _ = _disparities()
    path = make.write_pfm(tmp_path / "disp.pfm", disparity_px)
    with pytest.raises(SourceError, match="--intrinsics fx"):
        inverse_depth.read_disparity(path, SourceOptions(baseline_m=0.2))
    with pytest.raises(SourceError, match="--baseline-m"):
        inverse_depth.read_disparity(path, SourceOptions(intrinsics="1,1,0,0"))
    with pytest.raises(SourceError, match="no disparity above 0"):
        inverse_depth.read_disparity(make.write_pfm(tmp_path / "disp2.pfm", np.full((3, 3), np.inf)), RIG)
    with pytest.raises(SourceError, match="8-bit"):
        inverse_depth.read_disparity(make.write_png(tmp_path / "disp.png", np.zeros((3, 3), np.uint8)), RIG)
    (tmp_path / "disp_rgb.pfm").write_bytes(b"PF\n1 1\n-1\n" + bytes(12))
    with pytest.raises(SourceError, match="grey PFM"):
        inverse_depth.read_disparity(tmp_path / "disp_rgb.pfm", RIG)


def test_a_larger_offset_brings_the_scene_nearer() -> None:
    k = Intrinsics(100, 100, 0, 0)
    d = np.array([-5, 0, 1, 5, 50.0])
    nearer = inverse_depth.depth_of_disparity(d, inverse_depth.StereoRig(k, 0.2, 3.0))
    plain = inverse_depth.depth_of_disparity(d, inverse_depth.StereoRig(k, 0.2))
    negative = inverse_depth.depth_of_disparity(d, inverse_depth.StereoRig(k, 0.2, -5.0))
    assert nearer[:2].tolist() == plain[:2].tolist() == [0, 0]
    assert (nearer[2:] < plain[2:]).all()
    assert negative.tolist() == [0, 0, 0, 0, np.float32(100 * 0.2 / 45)]


def test_the_motorcycle_is_between_two_and_five_metres(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("skimage", reason="scikit-image is an optional extra")
    sequence = inverse_depth.motorcycle_sequence()
    depth = sequence.depth_m(0)
    known_m = depth[depth > 0]
    assert (sequence.width, sequence.height) == (741, 500)
    assert 2.0 < known_m.min() < 2.3 and 4.8 < known_m.max() < 5.2
    assert 0.90 < known_m.size / depth.size < 0.95

    def absent(name: str) -> ModuleType:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("touchfield.errors.import_module", absent)
    with pytest.raises(MissingExtra, match=r"touchfield\[motorcycle\]"):
        inverse_depth.motorcycle_sequence()
