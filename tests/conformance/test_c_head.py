"""`c/touch.h` reports every field of HEAD, and the frames of each segment in any order of access.

The values differ from every default and from each other; segment lengths differ, the last has one frame.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from second import CONFORMANCE
from test_c import COMPILER, built, run_with

from live_makers import HEAD
from object_makers import head_of, moving_scene
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.medium import ForceField, Grid
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.encoding import write_objects

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")

COUNTS = (3, 2, 1)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`head`, compiled with warnings as errors."""
    folder = tmp_path_factory.mktemp("c")
    source = Path(__file__).parent / "head.c"
    return built(folder, "head", "-O1", f"-I{CONFORMANCE.parent / 'c'}", source=source)


def voxels(path: Path) -> None:
    """Distinct frames on a lattice with distinct axes."""
    grid, rng = Grid((16, 8, 24), (0.01, 0.02, 0.005), (0.1, -0.2, 0.3)), np.random.default_rng(1)
    encoder = TouchEncoder(grid, TouchSpec(effort="fast", k=0.2, f0_n=0.07))
    dense = rng.normal(0, 1, (6, 16, 8, 24, 3)).astype(np.float32)
    fields = [ForceField.from_dense(grid, array) for array in dense]
    head = replace(
        HEAD, grid_shape=grid.shape, spacing_m=grid.spacing_m, origin_m=grid.origin_m, frame_count=6,
        rate_hz=37.5, axes="x länger, y up, z", device_name="mine", device_type=2,
        force_max_n=7.5, mapping_scale=0.5,
        mapping_offset_m=(1.25, -2.5, 3.75), weber_fraction=0.2, force_threshold_n=0.07, friction=0.3,
        damping_n_s_per_m=0.4, tags=("direct", "mine"), coder_parameters=encoder.parameters,
    )  # fmt: skip
    with TouchWriter(path) as writer:
        writer.write_head(head, {"source": "a test"})
        first = 0
        for count in COUNTS:
            writer.write_segment(first, count, encoder.encode_segment(fields[first : first + count]).body)
            first += count


def bodies(path: Path) -> None:
    """One body that tumbles, one at rest and one that deforms, with damping."""
    scene = moving_scene(6, surface_damping=0.5)
    encoder = ObjectsEncoder(scene, TouchSpec(effort="fast", segment_frames=3), 0.05)
    with TouchWriter(path) as writer:
        writer.write_head(replace(head_of(scene, encoder), mapping_scale=0.25), {})
        write_objects(writer, encoder, 6)


def expected_of(head: Head) -> dict[str, list[float] | str]:
    """The output lines of `head` that follow from HEAD."""
    numbers = ("rate_hz", "force_max_n", "mapping_scale", "weber_fraction", "force_threshold_n", "friction",
               "damping_n_s_per_m")  # fmt: skip
    return {
        "shape": list(head.grid_shape),
        **{name: list(getattr(head, name)) for name in ("spacing_m", "origin_m", "mapping_offset_m")},
        **{name: [getattr(head, name)] for name in numbers},
        **{name: getattr(head, name).encode().hex() for name in ("axes", "device_name", "coder")},
        "parameters": head.coder_parameters.hex(),
    }


@pytest.mark.parametrize("make", [voxels, bodies])
def test_every_field_and_every_segment_is_reported(make: object, program: Path, tmp_path: Path) -> None:
    path = tmp_path / "own.touch"
    make(path)  # type: ignore[operator]
    code, printed = run_with(program, path)
    assert code == 0
    lines = [line.split(" ") for line in printed.splitlines()]
    values = {line[0]: line[1:] for line in lines if line[0] != "frame"}
    with TouchReader(path) as reader:
        head, segments, objects = reader.head, reader.segments, reader.object_count
    for name, value in expected_of(head).items():
        found = values[name]
        assert (found == [value]) if isinstance(value, str) else ([float(n) for n in found] == value), name
    assert [int(n) for n in values["counts"]] == [6, len(segments), objects, head.device_type]
    segment_indices = [n for n, entry in enumerate(segments) for _ in range(entry.frame_count)]
    assert [int(n) for n in values["segment_of"]] == segment_indices and len(segments) > 1
    assert values["size"] == ["1"] and values["room"] == ["1", "1"] and values["codes"] == ["6", "0", "none"]
    with open_file(path) as stream:
        fields = [field.to_dense() for field in stream.medium]
        damping = 0.0 if stream.scene is None else stream.scene.surface_damping_n_s_per_m
    backwards = [entry for entry in reversed(segments) for _ in range(2)]
    order = [entry.first_frame + i for entry in backwards for i in range(entry.frame_count)]
    frames = [line[1:] for line in lines if line[0] == "frame"]
    assert [int(line[0]) for line in frames] == order
    for line in frames:
        assert [int(n) for n in line[1:4]] == [max(objects, 1), objects > 0, 0]
        assert [float(n) for n in line[4:6]] == [damping, head.force_max_n]
        diagonal = np.array([[float(n) for n in line[6:]]]).reshape(-1, 3)
        at = range(min(head.grid_shape))
        np.testing.assert_allclose(diagonal, fields[int(line[0])][at, at, at], atol=2e-6)
    assert any(fields[n][at, at, at].any() for n in range(6))
