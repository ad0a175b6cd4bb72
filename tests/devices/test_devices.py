"""Device profiles and figures of human perception: complete, with sources, and strictly validated."""

from __future__ import annotations

import math
import tomllib
from dataclasses import fields
from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from touchfield.devices import Device, device, device_names, devices
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.perception import figure, human

POINTS = {
    "phantom-omni",
    "touch",
    "touch-x",
    "phantom-premium-1.5",
    "novint-falcon",
    "omega.3",
    "delta.3",
    "sigma.7",
    "haply-inverse3",
    "phantom-premium-1.5-6dof",
}
ARRAYS = {
    "tshirt-32x32",
    "tactile-vest-8x8",
    "tactsuit-x40",
    "tactsuit-pro",
    "tactsuit-air",
    "tactsuit-x16",
    "dotpad",
    "graphiti",
    "hyperbraille",
}

POINT = """
name = "mine"
title = "My device"
type = 1
[axes]
value = "x right, y up, z towards the user"
source = "me"
[workspace_mm]
value = [100, 80.0, 60.0]
source = "me"
[resolution_mm]
value = 0.1
source = "me"
[nominal_lattice]
value = [1000, 800, 600]
source = "me"
[force_max_n]
value = 5.0
source = "me"
[rate_hz]
value = 1000
source = "me"
"""


def write_profile(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text, "utf-8")
    return path


def test_all_listed_devices_exist() -> None:
    assert {d.name for d in devices() if d.type == 1} == POINTS
    assert {d.name for d in devices() if d.type == 2} == ARRAYS
    assert device_names() == tuple(sorted(POINTS | ARRAYS))


@pytest.mark.parametrize("profile", devices(), ids=lambda d: d.name)
def test_every_value_has_a_source(profile: Device) -> None:
    assert device(profile.name) is profile
    assert profile.title and profile.axes
    expected = {"axes", "force_max_n"} | (
        {"workspace_mm", "resolution_mm", "nominal_lattice", "rate_hz"}
        if profile.type == 1
        else {"columns", "rows", "pitch_mm", "depth_mm"}
    )
    assert expected <= set(profile.sources)
    assert all(text.strip() for text in profile.sources.values())
    assert 0 < (profile.force_continuous_n or profile.force_max_n) <= profile.force_max_n
    # its users measure less than the data sheet says
    if profile.physical_mm and profile.name != "haply-inverse3":
        assert all(p >= n for p, n in zip(profile.physical_mm, profile.workspace_mm, strict=True))


def test_omni_has_the_eight_billion_samples_of_the_paper() -> None:
    omni = device("phantom-omni")
    assert omni.lattice == (2909, 2182, 1273)
    assert math.prod(omni.lattice) == pytest.approx(8.08e9, rel=1e-3)
    assert omni.workspace_m == pytest.approx((0.16, 0.12, 0.07))
    assert omni.force_max_n == 3.3 and not omni.is_array


def test_only_devices_with_torque_state_a_limit() -> None:
    stated = {d.name: d.torque_max_nm for d in devices() if d.torque_max_nm is not None}
    assert stated == {"sigma.7": 0.2, "phantom-premium-1.5-6dof": 0.188}
    assert all("maximum angular torque" in device(name).sources["torque_max_nm"] for name in stated)


def test_arrays_count_their_actuators() -> None:
    counts = {d.name: d.lattice[0] * d.lattice[1] * d.panels for d in devices() if d.is_array}
    assert counts == {
        "tshirt-32x32": 1024,
        "tactile-vest-8x8": 64,
        "tactsuit-x40": 40,
        "tactsuit-pro": 32,
        "tactsuit-air": 16,
        "tactsuit-x16": 16,
        "dotpad": 2400,
        "graphiti": 2400,
        "hyperbraille": 6240,
    }
    assert device("tshirt-32x32").sources["pitch_mm"].startswith("our choice")
    assert device("dotpad").lattice == (60, 40, 1) and device("dotpad").workspace_mm == (150.0, 100.0, 150.0)


def test_profile_files_are_named_as_their_devices() -> None:
    folder = resources.files("touchfield.devices") / "profiles"
    for name in device_names():
        assert f'name = "{name}"' in (folder / f"{name}.toml").read_text("utf-8")


def test_error_of_an_unknown_name_suggests_the_nearest() -> None:
    with pytest.raises(InvalidArgument, match=r"phantom-omni, .*Did you mean phantom-omni\?") as caught:
        device("phantom-omny")
    assert caught.value.exit_code == 2
    with pytest.raises(InvalidArgument, match="path of a TOML profile"):
        device("qqqq")


def test_user_profile(tmp_path: Path) -> None:
    path = write_profile(tmp_path, POINT)
    profile = device(path)
    assert profile == device(str(path)) and hash(profile) == hash(device(path))
    assert profile.lattice == (1000, 800, 600) and profile.force_continuous_n is None
    assert profile.sources["rate_hz"] == "me"
    # the maximum
    assert device(write_profile(tmp_path, POINT.replace("value = 1000\n", "value = 1e6\n"))).rate_hz == 1e6


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("value = 5.0", "value = -5.0", "force_max_n.value"),
        ("value = 5.0", "value = nan", "force_max_n.value"),
        ("value = 5.0", "value = inf", "force_max_n.value"),
        ("value = 5.0", "value = true", "force_max_n.value"),
        ("value = 5.0", 'value = "5"', "force_max_n.value"),
        ("value = 1000\n", "value = 0\n", "rate_hz.value"),
        ('value = 1000\nsource = "me"', "value = 1000", "rate_hz.source"),
        ('value = 1000\nsource = "me"', 'value = 1000\nsource = " "', "rate_hz.source"),
        ("[1000, 800, 600]", "[1000, 800, 601]", "nominal_lattice"),
        ("value = 0.1", "value = 1e-320", "nominal_lattice"),
        ("[1000, 800, 600]", "[1000, 800]", "nominal_lattice.value"),
        ("[1000, 800, 600]", "[1000, 800, 1e9]", "nominal_lattice.value"),
        ("[100, 80.0, 60.0]", "[100, 80.0, 2e6]", "workspace_mm.value"),
        ("[rate_hz]", "[rate]", "rate: found an unknown key"),
        ("type = 1", "type = 3", "type"),
        ("type = 1", "type = true", "type"),
        ("type = 1", "type = [1]", "type"),
        ("type = 1", "type = 2", "unknown key"),
        ('name = "mine"', "", "name"),
        ('source = "me"\n[rate_hz]', 'source = "me"\nunit = "N"\n[rate_hz]', "force_max_n.unit"),
        ("[rate_hz]\nvalue = 1000\nsource = \"me\"", "", "rate_hz: found nothing"),
        ("[axes]", "axes = 3\n[other]", "axes|other"),
    ],
)  # fmt: skip
def test_error_of_a_faulty_profile_names_file_and_field(
    tmp_path: Path, old: str, new: str, field: str
) -> None:
    assert old in POINT
    with pytest.raises(DeviceError, match=rf"mine\.toml: .*({field})"):
        device(write_profile(tmp_path, POINT.replace(old, new)))


def test_array_shows_forces_or_heights(tmp_path: Path) -> None:
    pins = [name for name in device_names() if device(name).shows == "height"]
    assert pins == ["dotpad", "graphiti", "hyperbraille"]
    text = (resources.files("touchfield.devices") / "profiles" / "graphiti.toml").read_text()
    path = write_profile(tmp_path, text.replace('"height"', '"braille"'))
    with pytest.raises(
        DeviceError, match=r"mine\.toml: shows\.value: found 'braille'; expected force, or height"
    ):
        device(path)


@pytest.mark.parametrize("key", ["axes", "columns", "rows", "pitch_mm", "depth_mm", "force_max_n"])
def test_array_without_a_required_key_is_refused(tmp_path: Path, key: str) -> None:
    text = (resources.files("touchfield.devices") / "profiles" / "graphiti.toml").read_text()
    before, _, rest = text.partition(f"[{key}]")
    path = write_profile(tmp_path, before + "[".join(["", *rest.split("[")[1:]]))
    with pytest.raises(DeviceError, match=rf"mine\.toml: {key}: found nothing"):
        device(path)


@pytest.mark.parametrize(("columns", "rows"), [(100_000, 1), (1, 1025), (1024, 17)])
def test_array_with_too_many_actuators_is_refused(tmp_path: Path, columns: int, rows: int) -> None:
    text = (resources.files("touchfield.devices") / "profiles" / "tshirt-32x32.toml").read_text()

    def array(columns: int, rows: int) -> Path:
        return write_profile(
            tmp_path,
            f"value = {rows}".join(text.replace("value = 32", f"value = {columns}", 1).split("value = 32")),
        )

    assert device(array(1024, 16)).lattice == (1024, 16, 1)
    message = (
        f"mine.toml: columns and rows: found {columns} x {rows} actuators; expected 1024 on a side and 16384 "
        "in all"
    )
    with pytest.raises(DeviceError, match=message):
        device(array(columns, rows))


def test_invalid_profile_files_are_refused(tmp_path: Path) -> None:
    for data in (b"\xff\xfe", b"[", b"a = " + b"[" * 50_000, b"x" * 70_000):
        (tmp_path / "mine.toml").write_bytes(data)
        with pytest.raises(DeviceError, match=r"mine\.toml"):
            device(tmp_path / "mine.toml")
    for path in (tmp_path, tmp_path / "none.toml", "a\0b/c.toml"):
        with pytest.raises(DeviceError):
            device(path)


@given(st.text(max_size=300).filter(lambda t: t not in device_names()))
def test_any_text_raises_a_named_error(text: str) -> None:
    with pytest.raises((DeviceError, InvalidArgument)) as caught:
        device(text)
    assert "\n" not in str(caught.value)


def test_figures_of_perception_have_units_and_sources() -> None:
    assert figure("force_threshold_n") == 0.05
    assert figure("force_weber_fraction") == 0.07
    assert human()["deadband_paper"].values == (0.01, 0.1, 0.25)
    for entry in human().values():
        assert entry.unit and entry.source and len(entry.of) in (0, len(entry.values))
        assert all(v > 0 for v in entry.values)
    with pytest.raises(InvalidArgument, match="force_threshold_n"):
        figure("patience")


@pytest.mark.parametrize("name", device_names())
def test_profile_attributes_have_the_values_of_their_keys(name: str) -> None:
    file = resources.files("touchfield.devices") / "profiles" / f"{name}.toml"
    table, found = tomllib.loads(file.read_text("utf-8")), device(name)
    assert (found.name, found.title, found.type) == (table["name"], table["title"], table["type"])
    values = {key: entry["value"] for key, entry in table.items() if isinstance(entry, dict)}
    sources = {key: entry["source"] for key, entry in table.items() if isinstance(entry, dict)}
    assert {key: text.strip() for key, text in sources.items()} == dict(found.sources)
    if found.is_array:
        columns, rows, depth = (values.pop(key) for key in ("columns", "rows", "depth_mm"))
        pitch = values["pitch_mm"]
        assert found.lattice == (columns, rows, 1)
        assert found.workspace_mm == pytest.approx((columns * pitch, rows * pitch, depth))
    else:
        assert found.lattice == tuple(values.pop("nominal_lattice"))
    for key, value in values.items():
        assert getattr(found, key) == (tuple(value) if isinstance(value, list) else value), key
    defaults = {"sources", "shows", "panels", "lattice", "workspace_mm", "name", "title", "type"}
    for item in fields(found):
        if item.name not in values and item.name not in defaults:
            assert getattr(found, item.name) is None, item.name
    assert found.workspace_m == pytest.approx([mm / 1000 for mm in found.workspace_mm])


def test_limits_of_profile_numbers_are_inclusive(tmp_path: Path) -> None:
    def lattice(count: int) -> Path:
        text = POINT.replace("[1000, 800, 600]", f"[{count}, 800, 600]").replace(
            "[100, 80.0", f"[{count / 10}, 80.0"
        )
        return write_profile(tmp_path, text)

    assert device(lattice(1 << 20)).lattice == (1 << 20, 800, 600)
    with pytest.raises(
        DeviceError, match=r"nominal_lattice\.value: found 1048577; .*a positive whole number up to"
    ):
        device(lattice((1 << 20) + 1))
    with pytest.raises(
        DeviceError, match=r"rate_hz\.value: found 1000001; expected a positive number up to 1000000"
    ):
        device(write_profile(tmp_path, POINT.replace("value = 1000\n", "value = 1000001\n")))
    wide = POINT.replace("[1000, 800, 600]", "[1000, 800, 601]")
    with pytest.raises(
        DeviceError, match=r"found \(1000, 800, 601\); expected \(1000, 800, 600\), workspace_mm over"
    ):
        device(write_profile(tmp_path, wide))
