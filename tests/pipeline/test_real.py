"""Real inputs, end to end; skipped without the optional folder of real inputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from touchfield.codec.paper.spec import PaperSpec
from touchfield.pipeline import compare, encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import DepthSequence
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source

pytestmark = pytest.mark.shared

SEQUENCES = ("rgbd_tum_fr1_rpy", "rgbd_iclnuim_livingroom1")
MESHES = (
    "spot/spot_triangulated.obj",
    "fox/Fox.glb",
    "morph_stress_test/MorphStressTest.gltf",
    "featuretype/featuretype.STL",
    "parasaurolophus_scan/parasaurolophus_6700.ply",
)


def round_trip(source: Path, stream: Path, spec: EncodeSpec) -> dict:
    done = encode(source, stream, spec)
    assert done.supported_voxels > 0
    compared = compare(source, stream).summary()
    assert compared["supported_voxels"] == done.supported_voxels
    assert compared["nmse_db"] < -12
    with open_file(stream) as opened:
        assert opened.medium[len(opened.medium) - 1].support_count > 0
    return compared


@pytest.mark.parametrize("name", SEQUENCES)
@pytest.mark.parametrize("reading", ["camera", "height"])
def test_every_sequence(shared_data: Path, tmp_path: Path, name: str, reading: str) -> None:
    frames = None if reading == "camera" else (0, 6)  # the pictures are the same
    spec = EncodeSpec(nw=5, frames=frames, source=SourceOptions(reading=reading))
    compared = round_trip(shared_data / name, tmp_path / "s.touch", spec)
    assert compared["frames"] == (24 if reading == "camera" else 6)


@pytest.mark.parametrize("name", MESHES)
def test_every_mesh(shared_data: Path, tmp_path: Path, name: str) -> None:
    frames = {"MorphStressTest.gltf": (100, 108), "Fox.glb": (0, 8)}.get(Path(name).name)  # of 560, of 275
    round_trip(shared_data / "meshes" / name, tmp_path / "m.touch", EncodeSpec(nw=6, frames=frames))


def test_trends_of_the_paper_on_a_real_sequence(shared_data: Path, tmp_path: Path) -> None:
    source = shared_data / "rgbd_iclnuim_livingroom1"

    def figures(frames: int, **paper: object) -> dict:
        spec = EncodeSpec(nw=6, frames=(0, frames), coder="paper", paper=PaperSpec(**paper))
        return round_trip(source, tmp_path / "s.touch", spec)

    by_k = [figures(1, k=k, directions="octa3") for k in (0.01, 0.1, 0.25)]
    assert by_k[0]["cr_full"] > by_k[1]["cr_full"] > by_k[2]["cr_full"]
    assert by_k[0]["nmse_db"] < by_k[1]["nmse_db"] < by_k[2]["nmse_db"]
    coarse = figures(1, k=0.01, directions="ico3")
    assert coarse["nmse_db"] > by_k[0]["nmse_db"] + 2
    # CR is per frame: each of several frames of a static world takes no more than the first one alone
    single, three = figures(1), figures(3)
    assert three["cr_full"] < single["cr_full"]


class Standing(DepthSequence):
    """The first frame of a real sequence repeated, with flicker in the last digit of the sensor."""

    def __init__(self, sequence: DepthSequence, frames: int) -> None:
        self.name, self.frame_count = "standing", frames
        self.width, self.height = sequence.width, sequence.height
        self.intrinsics, self.rate_hz = sequence.intrinsics, sequence.rate_hz
        self._depth = sequence.depth_m(0)

    def depth_m(self, frame: int) -> np.ndarray:
        flicker = np.random.default_rng(frame).integers(-1, 2, self._depth.shape) * np.float32(0.001)
        return np.where(self._depth > 0, self._depth + flicker, 0).astype(np.float32)


def test_a_static_scene_before_a_static_camera(shared_data: Path, tmp_path: Path) -> None:
    scene = open_source(shared_data / "rgbd_tum_fr1_rpy")
    assert isinstance(scene, DepthScene)
    bits = {}
    for frames in (1, 2, 5):
        standing = DepthScene(Standing(scene.sequence, frames))
        compared = round_trip(standing, tmp_path / "s.touch", EncodeSpec(nw=6))
        bits[frames] = compared["file_bytes"] / frames
    assert bits[2] < 0.95 * bits[1]
    assert bits[5] < 0.6 * bits[1]
