"""Intrinsics of cameras in all forms, and errors that name the file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth import intrinsics_file

FORMS = {
    "one line": "20 21 5.5 4",
    "commas": "20,21,5.5,4",
    "3x3": "20 0 5.5\n0 21 4\n0 0 1\n",
    "4x4": "20 0 5.5 0\n0 21 4 0\n0 0 1 0\n0 0 0 1",
    "commented": "# camera\n20 0 5.5\n0 21 4 # y\n0 0 1",
    "open3d": json.dumps({"width": 12, "height": 9, "intrinsic_matrix": [20, 0, 0, 0, 21, 0, 5.5, 4, 1]}),
    "open3d parameters": json.dumps({"intrinsic": {"intrinsic_matrix": [20, 0, 0, 0, 21, 0, 5.5, 4, 1]}}),
    "named": json.dumps({"fx": 20, "fy": 21, "cx": 5.5, "cy": 4}),
}


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_all_forms_of_intrinsics_are_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "k").write_text(text)
    expected = Intrinsics(20, 21, 5.5, 4)
    assert intrinsics_file.parse_intrinsics(text, "k", (12, 9)).intrinsics == expected
    assert intrinsics_file.camera_of("s", str(tmp_path / "k"), (), (12, 9)).intrinsics == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("20 21 5.5", "3 numbers"),
        ("20 x 5 4", "20 x 5 4"),
        ("-20 21 5 4", "fx = -20"),
        ("20 21 nan 4", "cx = nan"),
        ("20 0 0 0 21 0 5.5 4 1", "no skew"),
        ("20 3 5 0 21 4 0 0 1", "no skew"),
        ("20 0 5 1 21 4 0 0 1", "no skew"),
        ('{"intrinsic_matrix": [1, 2]}', "2 numbers"),
        ('{"width": 640, "height": 480, "fx": 1, "fy": 1, "cx": 1, "cy": 1}', "640 x 480"),
        ('{"width": 12, "height": 10, "fx": 1, "fy": 1, "cx": 1, "cy": 1}', "12 x 10"),
        ('{"fx": 1', "JSON"),
        ('{"fx": "a"}', "without numbers"),
    ],
)
def test_bad_intrinsics_name_file_and_fault(text: str, message: str) -> None:
    with pytest.raises(SourceError, match=f"k.txt.*{message}"):
        intrinsics_file.parse_intrinsics(text, "k.txt", (12, 9))


@pytest.mark.parametrize("text", ["1,2,3", "nothing/there.txt", "1,2,3,x", "0,1,2,3", "", "\0", "a" * 5000])
def test_intrinsics_that_are_neither_numbers_nor_a_file_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument, match="--intrinsics"):
        intrinsics_file.camera_of("s", text, (), (12, 9))


def test_a_scale_above_a_nested_camera_belongs_to_it() -> None:
    inner = '"camera": {"fx": 1, "fy": 1, "cx": 1, "cy": 1'
    for text in (
        f'{{"depth_scale": 500, {inner}}}}}',
        f'{{"depth_scale": 500, {inner}, "depth_scale": 2000}}}}',
    ):
        assert intrinsics_file.parse_intrinsics(text, "k.txt").units_per_m == 500
