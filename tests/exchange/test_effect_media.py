"""Effects between files, media and arrays: where each drive lies, what is told of it, and the limits."""

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
    """Drives unlike each other, some of them off; some frequencies are not known."""
    rng = np.random.default_rng(seed)
    drives = rng.uniform(0.1, 1, (frames, rows, columns)) * (rng.random((frames, rows, columns)) < 0.7)
    hertz = rng.uniform(50, 300, drives.shape) * (rng.random(drives.shape) < 0.6)
    return ArrayEffect(25.0, drives.astype(np.float32), hertz.astype(np.float32))


@pytest.mark.parametrize("has_hertz", [True, False])
def test_each_drive_is_the_force_and_the_vibration_of_its_actuator(has_hertz: bool) -> None:
    """Row 0 is the top one: y counts upwards in the medium; and `Drives` finds it again."""
    effect = random_effect()
    effect = effect if has_hertz else replace(effect, frequencies_hz=None)
    chosen = effect_device(effect.lattice, force_max_n=2.5)
    medium = effect_medium(effect, device_grid(chosen), 2.5, {"format": "x"})
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
        places = [(column, 1 - y) for column, y, _ in band.positions.tolist()]
        known = dict(zip(places, zip(band.amplitudes_n, band.frequencies_hz, strict=True), strict=True))
        wanted = np.argwhere((effect.drives[n] > 0) & (effect.frequencies_hz[n] > 0)).tolist()
        assert sorted(known) == sorted((column, row) for row, column in wanted)
        for (column, row), (amplitude_n, hertz) in known.items():
            assert amplitude_n == pytest.approx(2.5 * effect.drives[n, row, column], rel=1e-6)
            assert hertz == effect.frequencies_hz[n, row, column]
    drives = Drives(medium, chosen, 2.5)
    for n in range(len(drives)):
        np.testing.assert_allclose(drives.drives(n)[0], effect.drives[n], rtol=1e-6)
        hertz = drives.frequencies(n)
        assert (hertz is None) != has_hertz
        if hertz is not None and effect.frequencies_hz is not None:
            own = np.where(effect.drives[n] > 0, effect.frequencies_hz[n], 0)
            np.testing.assert_array_equal(hertz[0], own)
    with pytest.raises(InvalidArgument, match="as the effect has it"):
        effect_medium(effect, device_grid(effect_device((2, 4, 1))), 2.5, {})


def test_a_panel_is_driven_and_the_other_one_stays_off() -> None:
    vest = device("tactsuit-x40")
    columns, rows, _ = vest.lattice
    effect = random_effect(2, rows, columns, seed=3)
    medium = effect_medium(effect, device_grid(replace(vest, panels=1)), 2.0, {})
    for place, panel in enumerate(PANELS):
        drives = Drives(medium, vest, 2.0, panel)
        for n in (0, 1):
            found, hertz = drives.drives(n), drives.frequencies(n)
            np.testing.assert_allclose(found[place], effect.drives[n], rtol=1e-6)
            assert hertz is not None and hertz[place].any() and not hertz[1 - place].any()
            assert not found[1 - place].any()


def by_hand(drives: np.ndarray, hertz: np.ndarray) -> np.ndarray:
    """Of one actuator: the last known frequency, before the first that one, else the usual."""
    known = [n for n in range(len(drives)) if drives[n] > 0 and hertz[n] > 0]
    if not known:
        return np.full(len(drives), DEFAULT_CARRIER_HZ)
    return np.array([hertz[max([k for k in known if k <= n], default=known[0])] for n in range(len(drives))])


def test_a_frequency_that_is_not_told_is_the_last_one_that_was() -> None:
    for drives in product((0.0, 0.5), repeat=4):
        for hertz in product((0.0, 70.0), (80.0, 0.0), (0.0, 90.0), (0.0, 100.0)):
            one, other = np.array(drives, np.float32), np.array(hertz, np.float32)
            assert filled_hz(one, other).tolist() == by_hand(one, other).tolist(), (drives, hertz)
    effect = random_effect(6, 2, 3, seed=5)
    assert effect.frequencies_hz is not None
    found = filled_hz(effect.drives, effect.frequencies_hz)
    for row, column in product(range(2), range(3)):
        at = np.s_[:, row, column]
        assert found[at].tolist() == by_hand(effect.drives[at], effect.frequencies_hz[at]).tolist()
    assert (filled_hz(effect.drives, None) == DEFAULT_CARRIER_HZ).all()


def test_drives_that_meet_add_up_and_the_stronger_gives_the_frequency() -> None:
    one, other = Drive.silent(4), Drive(np.array([0.2, 0.5]), np.array([60.0, 70.0]))
    one.add(Drive(np.array([0.1, 0.2, 0.5, 0.4]), np.array([10.0, 20.0, 30.0, 40.0])))
    one.add(other, slice(1, 3))
    assert one.amplitudes.tolist() == [0.1, 0.4, 1.0, 0.4]
    assert one.frequencies_hz.tolist() == [10.0, 20.0, 30.0, 40.0], "of equal ones that which was there"
    one.add(Drive(np.array([0.5]), np.array([50.0])), slice(3, 4))
    assert one.frequencies_hz[3] == 50.0


def test_the_device_of_an_effect_is_a_profile_only_where_all_of_it_fits() -> None:
    vest = device("tactsuit-x40")
    for force_max_n in (None, vest.force_max_n):
        assert effect_device(vest.lattice, vest.name, force_max_n) is vest
    columns, rows, _ = vest.lattice
    for lattice, name, force_max_n in (
        ((rows, columns, 1), vest.name, None), (vest.lattice, vest.name, 2 * vest.force_max_n),
        (vest.lattice, "phantom-omni", None), (vest.lattice, "unknown", None), (vest.lattice, "", 0.5),
    ):  # fmt: skip
        own = effect_device(lattice, name, force_max_n)
        assert own.name == f"array-{lattice[0]}x{lattice[1]}" and own.lattice == lattice and own.type == 2
        assert own.force_max_n == (force_max_n or 3.3) and own.pitch_mm == 20.0
        assert own.workspace_mm == (20.0 * lattice[0], 20.0 * lattice[1], 20.0 * max(lattice))
        assert str(lattice[0]) in own.title and set(own.sources) == {"pitch_mm", "force_max_n"}


def test_numbers_of_an_effect_at_their_limits() -> None:
    good = np.full((2, 1, 3), 0.5, np.float32)
    for drives, hertz in (
        (0 * good, None), (0 * good + 1, 0 * good), (good, 0 * good + np.float32(MAX_FREQUENCY_HZ)),
    ):  # fmt: skip
        assert ArrayEffect(1e-9, drives, hertz).lattice == (3, 1, 1)
    above = np.nextafter(np.float32(1), np.float32(2))
    for drives, hertz, where in (
        (good + above, None, "drives"), (-good, None, "drives"), (good * np.nan, None, "drives"),
        (good.astype(float), None, "drives"), (good[0], None, "drives"), (good[:0], None, "drives"),
        (good, -good, "frequencies_hz"), (good, good * np.nan, "frequencies_hz"),
        (good, good[:1], "frequencies_hz"),
        (good, 0 * good + np.nextafter(np.float32(MAX_FREQUENCY_HZ), np.float32(1e9)), "frequencies_hz"),
        (good, good.astype(float), "frequencies_hz"),
    ):  # fmt: skip
        with pytest.raises(InvalidArgument) as told:
            ArrayEffect(1.0, drives, hertz)
        assert told.value.where == where
    for rate_hz in (1, MAX_RATE_HZ):
        check_rate(rate_hz)
    for rate_hz in (0.999, MAX_RATE_HZ + 1):
        with pytest.raises(InvalidArgument, match="rate_hz"):
            check_rate(rate_hz)
    assert checked_frames("x", MAX_VALUES // 8, 8) == MAX_VALUES // 8
    with pytest.raises(InvalidArgument, match=f"{MAX_VALUES // 8 + 1} frames of 8 actuators"):
        checked_frames("x", MAX_VALUES // 8 + 1, 8)


# -- arrays by their names ----------------------------------------------------------------------------------


def test_a_drive_is_the_nearest_level_and_halves_go_up() -> None:
    panel = replace(device("dotpad"), lattice=(3, 2, 1), panels=1)
    drives = np.array([[[0.0, 0.1249, 0.125], [0.3751, 1.0, 7.0]]], np.float32)
    assert steps_of(panel, drives, 5).tolist() == [[[0, 0, 1], [2, 4, 4]]]
    odd = np.array([[[np.nan, -1.0, np.inf], [-np.inf, 0.5, 0.49]]], np.float32)
    assert drives_of(panel, odd).tolist() == [[[0.0, 0.0, 1.0], [0.0, 0.5, pytest.approx(0.49)]]]
    assert steps_of(panel, odd, 2).tolist() == [[[0, 0, 1], [0, 1, 0]]]
    for shape in ((2, 3), (1, 3, 2), (2, 2, 3), (1, 2, 4)):
        with pytest.raises(InvalidArgument, match=r"drives of dotpad: found shape .*; expected \(1, 2, 3\)"):
            drives_of(panel, np.zeros(shape, np.float32))


def test_the_profile_of_an_array_is_the_one_asked_for_the_stream_s_or_the_usual() -> None:
    usual, other = device("dotpad"), device("graphiti")
    shirt = device("tshirt-32x32")
    assert usual.shows == other.shows != shirt.shows
    assert registry.array_kinds()[2].name == "pins" and registry.array_kinds()[2].takes_any
    for asked, own, expected in (
        (None, None, usual), (None, other, other), (None, shirt, usual), (other, None, other),
        (usual, other, usual),
        (None, replace(other, type=1), usual),
    ):  # fmt: skip
        array = array_device(" PINS:/dev/null ", asked, own)
        assert isinstance(array, Pins) and array.profile is expected
    vest = array_device("bhaptics", None, shirt)
    assert vest.profile == device(str(registry.array_kinds()[0].profile)), "which does not take any"
    with pytest.raises(InvalidArgument, match=r"phantom-omni, a point; expected an array of actuators"):
        array_device("osc:127.0.0.1:9000", device("phantom-omni"))
    assert [is_array_device(words) for words in ("Osc:x:1", " pins:/dev/x", "sim", "oscar", "")] == [
        True, True, False, False, False,
    ]  # fmt: skip


def test_a_hand_on_a_device_takes_no_trajectory() -> None:
    trace = Trace(np.array([0.0, 1.0]), np.zeros((2, 3)))
    for words, name in ((" SIM ", "sim"), ("sim:spring", "sim"), ("haply", "haply")):
        is_simulated = name == "sim"
        choice = point_device(words, trace if is_simulated else None)
        assert (choice.name, choice.is_simulated) == (name, is_simulated)
        kind = next(kind for kind in registry.point_kinds() if kind.name == name)
        assert choice.profile == kind.profile
    with pytest.raises(InvalidArgument, match="one for haply; expected none"):
        point_device("haply", trace)
    for words, near in (("hapli", "haply"), ("openhaptic", "openhaptics"), ("xyz", "")):
        with pytest.raises(InvalidArgument) as told:
            point_device(words)
        assert told.value.where == "--device" and told.value.hint == (f"Did you mean {near}?" if near else "")
        kinds = (*registry.point_kinds(), *registry.array_kinds())
        assert all(kind.form in told.value.expected for kind in kinds)


# -- files --------------------------------------------------------------------------------------------------


def test_vests_that_dots_can_show() -> None:
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
def test_a_tap_lasts_no_longer_than_a_transient_and_has_an_end(rate_hz: float) -> None:
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
