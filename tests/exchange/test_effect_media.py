"""Effects converted to media and arrays: position of each drive, frequencies, and limits."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from touchfield.devices import device
from touchfield.devices.drivers import registry
from touchfield.devices.drivers.pins import Pins
from touchfield.devices.drivers.registry import (
    array_device,
    drives_of,
    is_array_device,
    point_device,
    steps_of,
)
from touchfield.errors import InvalidArgument
from touchfield.exchange.effect_files import SingleTrack, fits_vest, write_wav
from touchfield.exchange.symbolic import (
    DEFAULT_CARRIER_HZ,
    MAX_RATE_HZ,
    MAX_VALUES,
    TRANSIENT_S,
    ArrayEffect,
    Drive,
    check_rate,
    checked_frames,
    effect_device,
    effect_medium,
    filled_hz,
)
from touchfield.filters.device_spec import device_grid
from touchfield.medium.medium import MAX_FREQUENCY_HZ
from touchfield.medium.trace import Trace
from touchfield.pipeline.array_medium import PANELS, Drives


def random_effect(frames: int = 3, rows: int = 2, columns: int = 4, seed: int = 0) -> ArrayEffect:
    """Distinct drives, some of them off; some frequencies are unknown."""
    rng = np.random.default_rng(seed)
    drives = rng.uniform(0.1, 1, (frames, rows, columns)) * (rng.random((frames, rows, columns)) < 0.7)
    hertz = rng.uniform(50, 300, drives.shape) * (rng.random(drives.shape) < 0.6)
    return ArrayEffect(25.0, drives.astype(np.float32), hertz.astype(np.float32))


@pytest.mark.parametrize("has_hertz", [True, False])
def test_drives_become_forces_and_vibrations_of_actuators(has_hertz: bool) -> None:
    """Row 0 is the top: y points up in the medium; `Drives` inverts the mapping."""
    effect = random_effect()
    effect = effect if has_hertz else replace(effect, frequencies_hz=None)
    profile = effect_device(effect.lattice, force_max_n=2.5)
    medium = effect_medium(effect, device_grid(profile), 2.5, {"format": "x"})
    assert (medium.rate_hz, len(medium), medium.tags) == (25.0, 3, ("symbolic",))
    assert medium.provenance["format"] == "x" and medium.grid.shape == effect.lattice == (4, 2, 1)
    assert (medium.vibration is not None) == has_hertz
    for n in range(3):
        forces = medium[n].to_dense()
        assert not forces[..., :2].any()
        for row, column in product(range(2), range(4)):
            drive = 2.5 * effect.drives[n, row, column]
            assert forces[column, 1 - row, 0, 2] == pytest.approx(drive, rel=1e-6)
        if medium.vibration is None or effect.frequencies_hz is None:
            continue
        band = medium.vibration(n)
        actuators = [(column, 1 - y) for column, y, _ in band.positions.tolist()]
        band_values = dict(
            zip(actuators, zip(band.amplitudes_n, band.frequencies_hz, strict=True), strict=True)
        )
        expected = np.argwhere((effect.drives[n] > 0) & (effect.frequencies_hz[n] > 0)).tolist()
        assert sorted(band_values) == sorted((column, row) for row, column in expected)
        for (column, row), (amplitude_n, hertz) in band_values.items():
            assert amplitude_n == pytest.approx(2.5 * effect.drives[n, row, column], rel=1e-6)
            assert hertz == effect.frequencies_hz[n, row, column]
    drives = Drives(medium, profile, 2.5)
    for n in range(len(drives)):
        np.testing.assert_allclose(drives.drives(n)[0], effect.drives[n], rtol=1e-6)
        hertz = drives.frequencies(n)
        assert (hertz is None) != has_hertz
        if hertz is not None and effect.frequencies_hz is not None:
            expected_frequencies = np.where(effect.drives[n] > 0, effect.frequencies_hz[n], 0)
            np.testing.assert_array_equal(hertz[0], expected_frequencies)
    with pytest.raises(InvalidArgument, match="as the effect has it"):
        effect_medium(effect, device_grid(effect_device((2, 4, 1))), 2.5, {})


def test_one_panel_is_driven_and_the_other_is_off() -> None:
    vest = device("tactsuit-x40")
    columns, rows, _ = vest.lattice
    effect = random_effect(2, rows, columns, seed=3)
    medium = effect_medium(effect, device_grid(replace(vest, panels=1)), 2.0, {})
    for index, panel in enumerate(PANELS):
        drives = Drives(medium, vest, 2.0, panel)
        for n in (0, 1):
            found, hertz = drives.drives(n), drives.frequencies(n)
            np.testing.assert_allclose(found[index], effect.drives[n], rtol=1e-6)
            assert hertz is not None and hertz[index].any() and not hertz[1 - index].any()
            assert not found[1 - index].any()


def expected_hz(drives: np.ndarray, hertz: np.ndarray) -> np.ndarray:
    """For one actuator: the last known frequency; before the first, that one; otherwise the default."""
    known_frames = [n for n in range(len(drives)) if drives[n] > 0 and hertz[n] > 0]
    if not known_frames:
        return np.full(len(drives), DEFAULT_CARRIER_HZ)
    return np.array(
        [hertz[max([k for k in known_frames if k <= n], default=known_frames[0])] for n in range(len(drives))]
    )


def test_unknown_frequency_repeats_the_last_known() -> None:
    for drives in product((0.0, 0.5), repeat=4):
        for hertz in product((0.0, 70.0), (80.0, 0.0), (0.0, 90.0), (0.0, 100.0)):
            amplitudes, frequencies = np.array(drives, np.float32), np.array(hertz, np.float32)
            assert (
                filled_hz(amplitudes, frequencies).tolist() == expected_hz(amplitudes, frequencies).tolist()
            ), (drives, hertz)
    effect = random_effect(6, 2, 3, seed=5)
    assert effect.frequencies_hz is not None
    found = filled_hz(effect.drives, effect.frequencies_hz)
    for row, column in product(range(2), range(3)):
        at = np.s_[:, row, column]
        assert found[at].tolist() == expected_hz(effect.drives[at], effect.frequencies_hz[at]).tolist()
    assert (filled_hz(effect.drives, None) == DEFAULT_CARRIER_HZ).all()


def test_overlapping_drives_add_and_the_stronger_sets_the_frequency() -> None:
    total, added = Drive.silent(4), Drive(np.array([0.2, 0.5]), np.array([60.0, 70.0]))
    total.add(Drive(np.array([0.1, 0.2, 0.5, 0.4]), np.array([10.0, 20.0, 30.0, 40.0])))
    total.add(added, slice(1, 3))
    assert total.amplitudes.tolist() == [0.1, 0.4, 1.0, 0.4]
    assert total.frequencies_hz.tolist() == [10.0, 20.0, 30.0, 40.0], "of equal ones that which was there"
    total.add(Drive(np.array([0.5]), np.array([50.0])), slice(3, 4))
    assert total.frequencies_hz[3] == 50.0
    total.add(Drive(np.array([0.6]), np.array([60.0])), slice(3, 4))  # less than the sum, more than each
    assert total.frequencies_hz[3] == 60.0 and total.amplitudes[3] == pytest.approx(1.5)


def test_device_of_an_effect_is_a_profile_if_it_fits() -> None:
    vest = device("tactsuit-x40")
    for force_max_n in (None, vest.force_max_n):
        assert effect_device(vest.lattice, vest.name, force_max_n) is vest
    columns, rows, _ = vest.lattice
    for lattice, name, force_max_n in (
        ((rows, columns, 1), vest.name, None), (vest.lattice, vest.name, 2 * vest.force_max_n),
        (vest.lattice, "phantom-omni", None), (vest.lattice, "unknown", None), (vest.lattice, "", 0.5),
    ):  # fmt: skip
        generic = effect_device(lattice, name, force_max_n)
        assert (
            generic.name == f"array-{lattice[0]}x{lattice[1]}"
            and generic.lattice == lattice
            and generic.type == 2
        )
        assert generic.force_max_n == (force_max_n or 3.3) and generic.pitch_mm == 20.0
        assert generic.workspace_mm == (20.0 * lattice[0], 20.0 * lattice[1], 20.0 * max(lattice))
        assert str(lattice[0]) in generic.title and set(generic.sources) == {"pitch_mm", "force_max_n"}


def test_numbers_of_an_effect_at_their_limits() -> None:
    good = np.full((2, 1, 3), 0.5, np.float32)
    for drives, hertz in (
        (0 * good, None), (0 * good + 1, 0 * good), (good, 0 * good + np.float32(MAX_FREQUENCY_HZ)),
    ):  # fmt: skip
        assert ArrayEffect(1e-9, drives, hertz).lattice == (3, 1, 1)
    above = np.nextafter(np.float32(1), np.float32(2))
    for drives, hertz, parameter in (
        (good + above, None, "drives"), (-good, None, "drives"), (good * np.nan, None, "drives"),
        (good.astype(float), None, "drives"), (good[0], None, "drives"), (good[:0], None, "drives"),
        (good, -good, "frequencies_hz"), (good, good * np.nan, "frequencies_hz"),
        (good, good[:1], "frequencies_hz"),
        (good, 0 * good + np.nextafter(np.float32(MAX_FREQUENCY_HZ), np.float32(1e9)), "frequencies_hz"),
        (good, good.astype(float), "frequencies_hz"),
    ):  # fmt: skip
        with pytest.raises(InvalidArgument) as caught:
            ArrayEffect(1.0, drives, hertz)
        assert caught.value.where == parameter
    for rate_hz in (1, MAX_RATE_HZ):
        check_rate(rate_hz)
    for rate_hz in (0.999, MAX_RATE_HZ + 1):
        with pytest.raises(InvalidArgument, match="rate_hz"):
            check_rate(rate_hz)
    assert checked_frames("x", MAX_VALUES // 8, 8) == MAX_VALUES // 8
    with pytest.raises(InvalidArgument, match=f"{MAX_VALUES // 8 + 1} frames of 8 actuators"):
        checked_frames("x", MAX_VALUES // 8 + 1, 8)


# -- arrays by their names ----------------------------------------------------------------------------------


def test_drives_round_to_the_nearest_level_and_halves_up() -> None:
    panel = replace(device("dotpad"), lattice=(3, 2, 1), panels=1)
    drives = np.array([[[0.0, 0.1249, 0.125], [0.3751, 1.0, 7.0]]], np.float32)
    assert steps_of(panel, drives, 5).tolist() == [[[0, 0, 1], [2, 4, 4]]]
    odd = np.array([[[np.nan, -1.0, np.inf], [-np.inf, 0.5, 0.49]]], np.float32)
    assert drives_of(panel, odd).tolist() == [[[0.0, 0.0, 1.0], [0.0, 0.5, pytest.approx(0.49)]]]
    assert steps_of(panel, odd, 2).tolist() == [[[0, 0, 1], [0, 1, 0]]]
    for shape in ((2, 3), (1, 3, 2), (2, 2, 3), (1, 2, 4)):
        with pytest.raises(InvalidArgument, match=r"drives of dotpad: found shape .*; expected \(1, 2, 3\)"):
            drives_of(panel, np.zeros(shape, np.float32))


def test_profile_of_an_array_is_requested_from_stream_or_default() -> None:
    default, other = device("dotpad"), device("graphiti")
    shirt = device("tshirt-32x32")
    assert default.shows == other.shows != shirt.shows
    assert registry.array_kinds()[2].name == "pins" and registry.array_kinds()[2].takes_any
    for requested, stream_profile, expected in (
        (None, None, default), (None, other, other), (None, shirt, default), (other, None, other),
        (default, other, default),
        (None, replace(other, type=1), default),
    ):  # fmt: skip
        array = array_device(" PINS:/dev/null ", requested, stream_profile)
        assert isinstance(array, Pins) and array.profile is expected
    vest = array_device("bhaptics", None, shirt)
    assert vest.profile == device(str(registry.array_kinds()[0].profile)), "which does not take any"
    with pytest.raises(InvalidArgument, match=r"phantom-omni, a point; expected an array of actuators"):
        array_device("osc:127.0.0.1:9000", device("phantom-omni"))
    assert [is_array_device(text) for text in ("Osc:x:1", " pins:/dev/x", "sim", "oscar", "")] == [
        True, True, False, False, False,
    ]  # fmt: skip


def test_real_devices_take_no_trajectory() -> None:
    trace = Trace(np.array([0.0, 1.0]), np.zeros((2, 3)))
    for text, name in ((" SIM ", "sim"), ("sim:spring", "sim"), ("haply", "haply")):
        is_simulated = name == "sim"
        choice = point_device(text, trace if is_simulated else None)
        assert (choice.name, choice.is_simulated) == (name, is_simulated)
        kind = next(kind for kind in registry.point_kinds() if kind.name == name)
        assert choice.profile == kind.profile
    with pytest.raises(InvalidArgument, match="one for haply; expected none"):
        point_device("haply", trace)
    for text, suggestion in (("hapli", "haply"), ("openhaptic", "openhaptics"), ("xyz", "")):
        with pytest.raises(InvalidArgument) as caught:
            point_device(text)
        assert caught.value.where == "--device" and caught.value.hint == (
            f"Did you mean {suggestion}?" if suggestion else ""
        )
        kinds = (*registry.point_kinds(), *registry.array_kinds())
        assert all(kind.form in caught.value.expected for kind in kinds)


# -- files --------------------------------------------------------------------------------------------------


def test_vests_supported_by_dots() -> None:
    for lattice, fits in (
        ((4, 5, 1), True), ((4, 4, 1), True), ((4, 2, 1), True), ((4, 3, 1), False), ((5, 4, 1), False),
        ((4, 5, 2), False),
    ):  # fmt: skip
        assert fits_vest(lattice) == fits, lattice


def test_a_sound_has_up_to_4096_channels(tmp_path: Path) -> None:
    for channels, count in ((0, 1), (4097, 1), (2, 1 << 29)):
        with pytest.raises(InvalidArgument, match=f"{channels} channels of {count} samples"):
            write_wav(tmp_path / "x.wav", [], channels, count)
    assert not (tmp_path / "x.wav").exists()
    write_wav(tmp_path / "x.wav", [np.zeros((1, 4096))], 4096, 1)
    assert (tmp_path / "x.wav").stat().st_size == 44 + 2 * 4096


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_tap_is_no_longer_than_a_transient_and_ends(rate_hz: float) -> None:
    longest = int(TRANSIENT_S * rate_hz)
    for length, is_tap in ((1, True), (longest, True), (longest + 1, False)):
        drives = np.zeros((longest + 10, 1, 1), np.float32)
        drives[3 : 3 + length] = 0.25
        drives[3 + length // 2] = 0.75
        track = SingleTrack.from_effect(ArrayEffect(rate_hz, drives))
        expected = ((pytest.approx((3 + length // 2) / rate_hz), 0.75),) if is_tap else ()
        assert tuple((at, amplitude) for at, amplitude, _ in track.taps) == expected
        assert any(amplitude > 0 for _, amplitude in track.amplitudes) != is_tap
        assert track.seconds == pytest.approx((len(drives) - 1) / rate_hz)
    drives[:], drives[-1] = 0, 0.5
    assert not SingleTrack.from_effect(ArrayEffect(rate_hz, drives)).taps, "what is on at the end has none"
