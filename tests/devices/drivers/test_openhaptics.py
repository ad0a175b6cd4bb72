"""OpenHaptics against a fake driver that calls from a thread of its own: order, millimetres, clock, and the
end.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import time

import numpy as np
import pytest
from fake_driver import FakeDriver, built
from numba import njit

from touchfield.devices.drivers import openhaptics, registry
from touchfield.devices.drivers.openhaptics import OpenHaptics
from touchfield.devices.drivers.registry import point_device
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.render.block import Memory

VARIABLE = "TOUCHFIELD_OPENHAPTICS_LIBRARY"
TICKS, RELEASE, RAISE, NOW = 0, 1, 2, 3
PLACE, SIZE = 10, 20
WORDS = 512


@njit
def cycle(i8, u8, f8, f4, x, y, z, now_ns):
    """A stand-in with the renderer's signature: leaves in the block what it got,
    and goes to zero on release.
    """
    if i8[RAISE] and i8[TICKS] == i8[RAISE]:
        raise ValueError("a renderer at fault")
    u8[100 + i8[TICKS] % 256] = np.uint64(now_ns)
    f4[2 * WORDS - 1] = np.float32(0.25)
    f8[PLACE], f8[PLACE + 1], f8[PLACE + 2] = x, y, z
    i8[TICKS] += 1
    f8[SIZE] = max(0.0, f8[SIZE] - 0.1) if i8[RELEASE] else min(2.0, f8[SIZE] + 0.1)
    return f8[SIZE], -f8[SIZE], 0.0


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return built("fake_hd", tmp_path_factory.mktemp("hd"))


@pytest.fixture
def fake(library, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(library))
    driver = FakeDriver(library)
    yield driver
    assert not driver.faults, driver.faults


@pytest.fixture
def block():
    return Memory.empty(WORDS)


def driven(block: Memory, name: str | None = None) -> OpenHaptics:
    device = OpenHaptics(name, cycle)
    device.open()
    device.drive(block.i8.ctypes.data, block.words)
    return device


def until(condition) -> None:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end, "did not happen within 10 s"
        time.sleep(0.002)


def test_the_driver_calls_the_cycle_and_the_last_force_is_zero(fake, block) -> None:
    device = driven(block)
    until(lambda: block.i8[TICKS] > 60)
    block.i8[RELEASE] = 1
    device.close()
    device.close()
    forces = fake.forces
    ticks = int(block.i8[TICKS])
    assert fake.log == "IESRTD"
    assert len(forces) == ticks + 1  # and one more frame, of zero
    assert (
        np.abs(np.diff(forces[:, 0], prepend=0.0)) <= 0.1 + 1e-9
    ).all()  # down the ramp, and not by a step
    assert forces[:, 0].max() == pytest.approx(2.0) and (forces[:, 1] == -forces[:, 0]).all()
    assert not forces[-2:].any()
    assert block.f8[PLACE : PLACE + 3] == pytest.approx([0.0005 * (ticks % 200), -0.02, 0.03])  # metres
    assert block.f4[2 * WORDS - 1] == 0.25


def test_its_clock_is_that_of_the_servo(fake, block) -> None:
    before = time.perf_counter_ns()
    device = driven(block)
    until(lambda: block.i8[TICKS] > 30)
    block.i8[RELEASE] = 1
    device.close()
    times = block.u8[100 : 100 + min(256, int(block.i8[TICKS]))].astype(np.int64)
    assert before < times[0] and times[-1] < time.perf_counter_ns()
    if block.i8[TICKS] <= 256:
        assert (np.diff(times) > 0).all()


def test_the_interpreter_s_lock_is_not_needed(fake, block) -> None:
    """A thread that holds the lock in one long compiled call does not stop the ticks."""
    device = driven(block)
    until(lambda: block.i8[TICKS] > 5)
    before = int(block.i8[TICKS])
    held = spin(50_000_000)
    assert held > 0 and block.i8[TICKS] > before + 3
    block.i8[RELEASE] = 1
    device.close()


@njit
def spin(count):
    """Compiled without ``nogil``: it holds the lock all the time."""
    total = 1
    for n in range(count):
        total = (total * 1103515245 + n) % 2147483647
    return total + 1


def test_without_a_release_the_end_still_comes_and_the_last_force_is_zero(fake, block, monkeypatch) -> None:
    monkeypatch.setattr(openhaptics, "_RELEASE_S", 0.05)
    device = driven(block)
    until(lambda: block.i8[TICKS] > 30)
    device.close()
    assert fake.log == "IESRTD"
    assert fake.forces[-2].any() and not fake.forces[-1].any()


def test_a_renderer_that_raises_ends_with_a_force_of_zero(fake, block) -> None:
    block.i8[RAISE] = 25
    device = driven(block)
    until(lambda: len(fake.forces) == 26)
    assert fake.forces[24].any() and not fake.forces[25].any()
    until(lambda: device._box[4])
    with pytest.raises(DeviceError, match="renderer that failed"):
        device.watch()
    device.close()
    assert len(fake.forces) == 26 and fake.log == "IESRTD"


def test_a_fault_while_it_runs_is_told_to_the_one_who_watches(fake, block, monkeypatch) -> None:
    monkeypatch.setattr(openhaptics, "_SILENCE_S", 0.15)
    device = driven(block)
    for _ in range(2):  # it calls, however long it has run
        time.sleep(0.1)
        until(lambda: block.i8[TICKS] > 5)
        device.watch()
    fake.fail("hdEndFrame", 0x0204)  # the driver limits the force of itself: nothing to tell
    ticks = int(block.i8[TICKS])
    until(lambda: block.i8[TICKS] > ticks + 5)
    fake.fail("hdEndFrame", 0x0301)

    def watched() -> bool:
        device.watch()
        return False

    with pytest.raises(DeviceError, match=r"a fault while it ran .device already initiated, code 0x0301"):
        until(watched)
    block.i8[RELEASE] = 1
    device.close()
    assert not fake.forces[-1].any()
    with pytest.raises(DeviceError, match="not driven"):
        device.watch()


def test_a_driver_that_never_calls_is_told_and_let_go(fake, block, monkeypatch) -> None:
    monkeypatch.setattr(openhaptics, "_SILENCE_S", 0.05)
    monkeypatch.setattr(openhaptics, "_LAST_FRAME_S", 0.05)  # there is none
    fake.fail("dead", 0)
    device, kept = driven(block), len(openhaptics._LEAKED)
    time.sleep(0.1)
    with pytest.raises(DeviceError, match=r"not called for 0\.05 s, after 0 calls"):
        device.watch()
    device.close()
    assert fake.log == "IESRTUD" and not len(fake.forces)
    assert len(openhaptics._LEAKED) == kept + 1  # what such a driver may call after all is there


@pytest.mark.parametrize(("function", "log"), [
    ("hdInitDevice", "I"),
    ("hdEnable", "IETD"),
    ("hdScheduleAsynchronous", "IESTUD"),
    ("hdStartScheduler", "IESRTUD"),
])  # fmt: skip
@pytest.mark.parametrize(
    ("code", "words"), [(0x0301, "device already initiated"), (0x0303, "no reason given")]
)
def test_a_function_that_fails_is_told_and_the_device_let_go(
    fake, block, function, log, code, words, monkeypatch
) -> None:
    monkeypatch.setattr(openhaptics, "_LAST_FRAME_S", 0.05)  # there is none
    fake.fail(function, code)
    device = OpenHaptics(None, cycle)

    def begin() -> None:
        device.open()
        device.drive(block.i8.ctypes.data, block.words)

    with pytest.raises(DeviceError, match=f"{words}, code {code:#06x}") as caught:
        begin()
    assert "\n" not in str(caught.value)
    assert fake.log == log
    device.close()
    with pytest.raises(DeviceError, match="not open"):
        device.drive(block.i8.ctypes.data, block.words)


def test_no_device_is_told_also_where_the_driver_has_no_error(fake) -> None:
    fake.fail("nothing", 0)
    with pytest.raises(DeviceError, match=r"no device; expected one\. Is it plugged in"):
        OpenHaptics(None, cycle).open()
    assert fake.log == "I"


def test_the_name_reaches_the_driver_and_the_opener_another_process(fake) -> None:
    for words, name in (("openhaptics", "(default)"), ("openhaptics:Left Device", "Left Device")):
        choice = point_device(words)
        assert choice.profile == "touch"
        device = pickle.loads(pickle.dumps(choice.opener))()
        device._cycle = cycle
        device.open()
        assert fake.library.fake_configuration().decode() == name
        device.close()
        fake.library.fake_reset()


def test_it_is_driven_twice_but_not_at_once(fake, block) -> None:
    device = driven(block)
    with pytest.raises(DeviceError, match="driven already"):
        device.drive(block.i8.ctypes.data, block.words)
    block.i8[RELEASE] = 1
    device.close()
    block.i8[RELEASE] = 0
    device.open()
    device.drive(block.i8.ctypes.data, block.words)
    ticks = int(block.i8[TICKS])
    until(lambda: block.i8[TICKS] > ticks)
    block.i8[RELEASE] = 1
    device.close()
    assert not fake.forces[-1].any()


def test_it_is_not_asked(fake) -> None:
    device = OpenHaptics(None, cycle)
    for question in (device.position_m, lambda: device.put_force_n(0.0, 0.0, 0.0)):
        with pytest.raises(DeviceError, match="calls the renderer"):
            question()


def test_without_the_library_it_says_how_to_get_it(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "missing.so"))
    with pytest.raises(DeviceError, match=r"Install the maker's OpenHaptics .* in TOUCHFIELD_OPENHAPTICS"):
        OpenHaptics().open()
    assert openhaptics.DRIVER.names == (str(tmp_path / "missing.so"),)  # and no other
    (check,) = openhaptics.DRIVER.checks()
    assert not check.is_there and check.mend


@pytest.mark.parametrize("name", ["a" * 200, "a\nb", "a\x00b", "\udc80"])
def test_a_name_that_no_driver_has_is_refused(name) -> None:
    with pytest.raises(InvalidArgument, match="name of a device"):
        point_device(f"openhaptics:{name}")


def test_only_the_driver_of_the_named_device_is_imported() -> None:
    code = (
        "import sys; from touchfield.devices.drivers.registry import MODULES, is_array_device, point_device\n"
        "assert not is_array_device('haply') and point_device('haply').name == 'haply'\n"
        "print(*(m for m in MODULES.values() if f'touchfield.devices.drivers.{m}' in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["haply"]


def test_each_built_in_device_has_the_name_by_which_it_is_found() -> None:
    assert [kind.name for kind in registry.device_kinds()[: len(registry.MODULES)]] == [*registry.MODULES]


def test_the_registry_is_cheap_to_import() -> None:
    """Neither the compiler nor a library of a device is imported before a device is opened."""
    code = (
        "import sys; from touchfield.devices.drivers.registry import point_device, point_kinds\n"
        "for words in ('sim', 'haply', 'openhaptics', 'forcedimension'): point_device(words)\n"
        "assert len(point_kinds()) == 4\n"
        "print([name for name in ('numba', 'websockets', 'serial') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
