"""OpenHaptics with a fake driver that calls from its own thread: order, units, clock, and shutdown."""

from __future__ import annotations

import ctypes
import pickle
import subprocess
import sys
import time

import numpy as np
import pytest
from fake_driver import FakeDriver, built

from touchfield.devices.drivers import openhaptics, registry
from touchfield.devices.drivers.openhaptics import OpenHaptics
from touchfield.devices.drivers.registry import point_device
from touchfield.errors import DeviceError, InvalidArgument

VARIABLE = "TOUCHFIELD_OPENHAPTICS_LIBRARY"
TICKS, RELEASE, FAIL, SIZE, POSITION, TIMES = 0, 1, 2, 3, 4, 100
"""Numbers of eight bytes that the renderer of ``fake_hd.c`` reads and writes in place of a receiver."""
NUMBERS = 512


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return built("fake_hd", tmp_path_factory.mktemp("hd"))


@pytest.fixture
def fake(library, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(library))
    driver = FakeDriver(library)
    yield driver
    assert not driver.faults, driver.faults


class Block:
    """The memory of a receiver, as integers and as floats."""

    def __init__(self) -> None:
        self.i8 = np.zeros(NUMBERS, np.int64)
        self.f8 = self.i8.view(np.float64)


@pytest.fixture
def block():
    return Block()


def fake_device(fake: FakeDriver) -> OpenHaptics:
    """The device with the renderer of ``fake_hd.c``."""
    return OpenHaptics(None, ctypes.cast(fake.library.fake_tick, ctypes.c_void_p).value)


def drive(device: OpenHaptics, block: Block) -> None:
    device.drive(block.i8.ctypes.data, block.i8.nbytes)


def start_device(fake: FakeDriver, block: Block) -> OpenHaptics:
    device = fake_device(fake)
    device.open()
    drive(device, block)
    return device


def wait_until(condition) -> None:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end, "did not happen within 10 s"
        time.sleep(0.002)


def test_driver_calls_the_cycle_and_the_last_force_is_zero(fake, block) -> None:
    device = start_device(fake, block)
    wait_until(lambda: block.i8[TICKS] > 60)
    block.i8[RELEASE] = 1
    device.close()
    device.close()
    forces = fake.forces
    ticks = int(block.i8[TICKS])
    assert fake.log == "IESRTD"
    assert len(forces) == ticks + 1  # and one more frame of zero force
    assert (np.abs(np.diff(forces[:, 0], prepend=0.0)) <= 0.1 + 1e-9).all()  # along the ramp, without a step
    assert forces[:, 0].max() == pytest.approx(2.0) and (forces[:, 1] == -forces[:, 0]).all()
    assert not forces[-2:].any()
    assert block.f8[POSITION : POSITION + 3] == pytest.approx([0.0005 * (ticks % 200), -0.02, 0.03])  # metres


def test_clock_is_that_of_the_servo(fake, block) -> None:
    before = time.perf_counter_ns()
    device = start_device(fake, block)
    wait_until(lambda: block.i8[TICKS] > 30)
    block.i8[RELEASE] = 1
    device.close()
    times = block.i8[TIMES : TIMES + min(256, int(block.i8[TICKS]))]
    assert before < times[0] and times[-1] < time.perf_counter_ns()
    if block.i8[TICKS] <= 256:
        assert (np.diff(times) > 0).all()


def test_ticks_do_not_need_the_interpreter_lock(fake, block) -> None:
    """A thread that holds the lock in one long compiled call does not stop the ticks."""
    device = start_device(fake, block)
    wait_until(lambda: block.i8[TICKS] > 5)
    before = int(block.i8[TICKS])
    total = sum(range(10_000_000))  # one call that never releases the lock
    assert total > 0 and block.i8[TICKS] > before + 3
    block.i8[RELEASE] = 1
    device.close()


def test_close_without_a_release_ends_with_zero_force(fake, block, monkeypatch) -> None:
    monkeypatch.setattr(openhaptics, "_RELEASE_S", 0.05)
    device = start_device(fake, block)
    wait_until(lambda: block.i8[TICKS] > 30)
    device.close()
    assert fake.log == "IESRTD"
    assert fake.forces[-2].any() and not fake.forces[-1].any()


def test_failing_renderer_ends_with_zero_force(fake, block) -> None:
    block.i8[FAIL] = 25
    device = start_device(fake, block)
    wait_until(lambda: len(fake.forces) == 26)
    assert fake.forces[24].any() and not fake.forces[25].any()
    wait_until(lambda: device._driver.end)
    with pytest.raises(DeviceError, match="renderer that failed"):
        device.watch()
    device.close()
    assert len(fake.forces) == 26 and fake.log == "IESRTD"


def test_fault_while_running_is_raised_by_watch(fake, block, monkeypatch) -> None:
    monkeypatch.setattr(openhaptics, "_SILENCE_S", 0.15)
    device = start_device(fake, block)
    for _ in range(2):  # the driver calls at any time
        time.sleep(0.1)
        wait_until(lambda: block.i8[TICKS] > 5)
        device.watch()
    fake.fail("hdEndFrame", 0x0204)  # the driver limited the force by itself: no error
    ticks = int(block.i8[TICKS])
    wait_until(lambda: block.i8[TICKS] > ticks + 5)
    fake.fail("hdEndFrame", 0x0301)

    def watch() -> bool:
        device.watch()
        return False

    with pytest.raises(DeviceError, match=r"a fault while it ran .device already initiated, code 0x0301"):
        wait_until(watch)
    block.i8[RELEASE] = 1
    device.close()
    assert not fake.forces[-1].any()
    with pytest.raises(DeviceError, match="not driven"):
        device.watch()


def test_driver_that_never_calls_is_an_error_and_is_closed(fake, block, monkeypatch) -> None:
    monkeypatch.setattr(openhaptics, "_SILENCE_S", 0.05)
    monkeypatch.setattr(openhaptics, "_LAST_FRAME_S", 0.05)  # there is no last frame
    fake.fail("dead", 0)
    device, leaked_before = start_device(fake, block), len(openhaptics._LEAKED)
    time.sleep(0.1)
    with pytest.raises(DeviceError, match=r"not called for 0\.05 s, after 0 calls"):
        device.watch()
    device.close()
    assert fake.log == "IESRTUD" and not len(fake.forces)
    assert len(openhaptics._LEAKED) == leaked_before + 1  # a late call of such a driver finds its memory


@pytest.mark.parametrize(("function", "log"), [
    ("hdInitDevice", "I"),
    ("hdEnable", "IETD"),
    ("hdScheduleAsynchronous", "IESTUD"),
    ("hdStartScheduler", "IESRTUD"),
])  # fmt: skip
@pytest.mark.parametrize(
    ("code", "message"), [(0x0301, "device already initiated"), (0x0303, "no reason given")]
)
def test_failing_function_is_an_error_and_closes_the_device(
    fake, block, function, log, code, message, monkeypatch
) -> None:
    monkeypatch.setattr(openhaptics, "_LAST_FRAME_S", 0.05)  # there is no last frame
    fake.fail(function, code)
    device = fake_device(fake)

    def start() -> None:
        device.open()
        drive(device, block)

    with pytest.raises(DeviceError, match=f"{message}, code {code:#06x}") as caught:
        start()
    assert "\n" not in str(caught.value)
    assert fake.log == log
    device.close()
    with pytest.raises(DeviceError, match="not open"):
        drive(device, block)


def test_missing_device_is_an_error_without_a_driver_error(fake) -> None:
    fake.fail("nothing", 0)
    with pytest.raises(DeviceError, match=r"no device; expected one\. Is it plugged in"):
        fake_device(fake).open()
    assert fake.log == "I"


def test_name_reaches_the_driver_and_the_opener_is_picklable(fake) -> None:
    for text, name in (("openhaptics", "(default)"), ("openhaptics:Left Device", "Left Device")):
        choice = point_device(text)
        assert choice.profile == "touch"
        device = pickle.loads(pickle.dumps(choice.opener))()
        device.open()
        assert fake.library.fake_configuration().decode() == name
        device.close()
        fake.library.fake_reset()


def test_device_can_be_driven_twice_but_not_concurrently(fake, block) -> None:
    device = start_device(fake, block)
    with pytest.raises(DeviceError, match="driven already"):
        drive(device, block)
    block.i8[RELEASE] = 1
    device.close()
    block.i8[RELEASE] = 0
    device.open()
    drive(device, block)
    ticks = int(block.i8[TICKS])
    wait_until(lambda: block.i8[TICKS] > ticks)
    block.i8[RELEASE] = 1
    device.close()
    assert not fake.forces[-1].any()


def test_device_refuses_polling(fake) -> None:
    device = fake_device(fake)
    for question in (device.position_m, lambda: device.put_force_n(0.0, 0.0, 0.0)):
        with pytest.raises(DeviceError, match="calls the renderer"):
            question()


def test_missing_library_error_says_how_to_install_it(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "missing.so"))
    with pytest.raises(DeviceError, match=r"Install the maker's OpenHaptics .* in TOUCHFIELD_OPENHAPTICS"):
        OpenHaptics().open()
    assert openhaptics.DRIVER.names == (str(tmp_path / "missing.so"),)  # no other name is tried
    (check,) = openhaptics.DRIVER.checks()
    assert not check.is_there and check.mend


@pytest.mark.parametrize("name", ["a" * 200, "a\nb", "a\x00b", "\udc80"])
def test_unknown_names_are_refused(name) -> None:
    with pytest.raises(InvalidArgument, match="name of a device"):
        point_device(f"openhaptics:{name}")


def test_only_the_selected_driver_is_imported() -> None:
    code = (
        "import sys; from touchfield.devices.drivers.registry import MODULES, is_array_device, point_device\n"
        "assert not is_array_device('haply') and point_device('haply').name == 'haply'\n"
        "print(*(m for m in MODULES.values() if f'touchfield.devices.drivers.{m}' in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["haply"]


def test_built_in_devices_have_the_names_of_the_registry() -> None:
    assert [kind.name for kind in registry.device_kinds()[: len(registry.MODULES)]] == [*registry.MODULES]


def test_the_registry_is_cheap_to_import() -> None:
    """Neither the compiler nor a device library is imported before a device is opened."""
    code = (
        "import sys; from touchfield.devices.drivers.registry import point_device, point_kinds\n"
        "for words in ('sim', 'haply', 'openhaptics', 'forcedimension'): point_device(words)\n"
        "assert len(point_kinds()) == 4\n"
        "print([name for name in ('numba', 'websockets', 'serial') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
