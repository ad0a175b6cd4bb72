"""Every safety net of the servo under force and torque: both go to zero and stay within their limits.

A device with a tool, so that there is a torque, is served on a simulated clock. Each net is triggered by its
own fault.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from player_makers import AXES, GRID, RestingDevice, numbered_field

from touchfield.devices import device
from touchfield.errors import CorruptFile, DeviceError
from touchfield.medium import ForceField, HapticMedium
from touchfield.render import servo
from touchfield.render.block import Memory, layout
from touchfield.render.player import Session
from touchfield.render.point_device import Point, Quaternion
from touchfield.render.servo import VirtualClock, serve
from touchfield.render.spec import RenderSpec
from touchfield.render.tool import Tool

SIGMA = replace(device("sigma.7"), axes=AXES, torque_continuous_nm=None, force_continuous_n=None)
STICK = Tool(np.array([[0.02, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]]), "stick")
SPEC = RenderSpec(tool=STICK)
FIRES = 100
"""The tick at which the fault happens."""


class Wrist(RestingDevice):
    """Records every wrench with its time; a fault of the device overrides a method."""

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__()
        self.clock, self.wrenches, self.times_ns = clock, [], []  # type: ignore[var-annotated]

    @property
    def is_faulty(self) -> bool:
        return len(self.wrenches) >= FIRES

    def orientation(self) -> Quaternion:
        return 1.0, 0.0, 0.0, 0.0

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        self.put_force_n(fx, fy, fz)
        self.wrenches.append((fx, fy, fz, tx, ty, tz))
        self.times_ns.append(self.clock.now_ns())


class Silent(Wrist):
    """Does not answer."""

    def position_m(self) -> Point:
        if self.is_faulty:
            raise DeviceError("fake device", "no answer")
        return super().position_m()


class Slow(Silent):
    """Does not answer, and takes a second for each wrench; the last torque keeps acting."""

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        super().put_wrench(fx, fy, fz, tx, ty, tz)
        if self.is_faulty:
            self.clock.sleep_until(self.clock.now_ns() + 10**9)


class Unwilling(Wrist):
    """Refuses some wrenches."""

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        if FIRES <= len(self.wrenches) < FIRES + 5:
            self.wrenches.append(self.wrenches[-1])
            self.times_ns.append(self.clock.now_ns())
            raise OSError("a broken pipe")
        super().put_wrench(fx, fy, fz, tx, ty, tz)


class Nowhere(Wrist):
    """Reports an invalid position."""

    def position_m(self) -> Point:
        return (0.0, float("nan"), 0.0) if self.is_faulty else super().position_m()


class Unturned(Wrist):
    """Reports an invalid orientation."""

    def orientation(self) -> Quaternion:
        return (float("nan"), 0.0, 0.0, 0.0) if self.is_faulty else super().orientation()


class Away(Wrist):
    """Leaves the field."""

    def position_m(self) -> Point:
        return (9.0, 0.0, 0.0) if self.is_faulty else super().position_m()


def medium(is_readable: bool = True, force_n: float = 0.0) -> HapticMedium:
    """A steady push; if not readable, decoding fails from the third frame on."""

    def make(frame: int) -> ForceField:
        if frame > 1 and not is_readable:
            raise CorruptFile("segment 3", "a wrong checksum")
        if not force_n:
            return numbered_field(0)
        forces = np.zeros((*GRID.shape, 3), np.float32)
        forces[..., 2] = force_n
        return ForceField.from_dense(GRID, forces)

    return HapticMedium(GRID, 8.0, 20, make, AXES)


@dataclass(frozen=True)
class Net:
    """A fault, and whether it ends the servo with an error; `act` applies it to the block at tick `FIRES`."""

    make: type[Wrist] = Wrist
    act: Callable[[Memory], None] = lambda memory: None
    fails: type[Exception] | None = None
    is_stop: bool = False
    is_readable: bool = True


def _dead_player(memory: Memory) -> None:
    memory.receiver["orders"]["heartbeat_ns"] = 1


NETS = {
    "stop": Net(is_stop=True),
    "the device does not answer": Net(Silent, fails=DeviceError),
    "the device fails slowly": Net(Slow, fails=DeviceError),
    "the device refuses": Net(Unwilling, fails=OSError),
    "no place": Net(Nowhere),
    "no orientation": Net(Unturned),
    "outside the field": Net(Away),
    "the player is gone": Net(act=_dead_player),
    "the frames end": Net(is_readable=False),
}


def served(net: Net, spec: RenderSpec = SPEC, force_n: float = 0.0) -> tuple[Wrist, Memory]:
    """The device after two seconds in which the net brings the wrench to zero."""
    session = Session(medium(net.is_readable, force_n), SIGMA, spec)
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory)
    feeder = session.feeder(memory, is_timed=False)
    session.order(memory, mode=layout.PLAYING)
    clock = VirtualClock()
    clock.sleep_until(2_000_000_000)  # a dead process has been so for long
    device_ = net.make(clock)
    is_fed = True

    def must_stop() -> bool:
        nonlocal is_fed
        if is_fed:
            try:
                feeder.fill_lookahead(3)
            except CorruptFile:
                is_fed = False
        ticks = int(memory.receiver["counts"]["ticks"])
        if ticks == FIRES:
            net.act(memory)
        return ticks >= (FIRES if net.is_stop else 2000)

    with contextlib.nullcontext() if net.fails is None else pytest.raises(net.fails):
        serve(memory, device_, clock, must_stop)
    return device_, memory


@pytest.mark.parametrize("name", NETS)
def test_force_and_torque_push_before_the_fault_and_vanish_after(name: str) -> None:
    net = NETS[name]
    hand, memory = served(net)
    wrenches = np.array(hand.wrenches)
    force, torque = np.linalg.norm(wrenches[:, :3], axis=1), np.linalg.norm(wrenches[:, 3:], axis=1)
    assert force[FIRES - 1] > 0.4 and torque[FIRES - 1] > 0.005
    within = len(wrenches) if net.fails or net.is_stop else 400
    after = wrenches[within - 1 :] if net.fails or net.is_stop else wrenches[within:-1]
    assert len(after) and not after.any(), "zero in time, and not only as the servo ends"
    assert hand.closed == 1
    times_s = 1e-9 * np.diff(hand.times_ns)
    for part, name in ((wrenches[:, :3], "force"), (wrenches[:, 3:], "torque")):
        steps = np.linalg.norm(np.diff(part, axis=0), axis=1)
        slew_per_s = float(memory.receiver["settings"][f"{name}_limits"]["slew_per_s"])
        assert (steps <= slew_per_s * times_s * (1 + 1e-9) + 1e-9).all(), "no faster than the slew limit"


@pytest.mark.parametrize("slow", [{"slew_n_per_s": 4.0}, {"slew_nm_per_s": 0.1}])
def test_an_end_waits_for_the_slower_of_force_and_torque(slow: dict[str, float]) -> None:
    hand, _ = served(NETS["stop"], replace(SPEC, ramp_s=1e-3, **slow))  # type: ignore[arg-type]
    before, last = hand.wrenches[FIRES - 1], hand.wrenches[-1]
    assert any(before[:3]) and any(before[3:]) and not any(last)
    assert len(hand.wrenches) > FIRES + 20, "slowly, and to the end"


@pytest.mark.parametrize("name", ["force", "torque"])
def test_heat_and_peak_limit_force_and_torque_from_both_sides(name: str) -> None:
    """The peak at first, and in the long run the continuous limit: no more, and hardly less."""
    limits = {"force": (0.9, 0.3, 9.0, 5.0), "torque": (9.0, 5.0, 0.012, 0.004)}[name]
    spec = replace(
        SPEC, **dict(zip(("peak_n", "continuous_n", "peak_nm", "continuous_nm"), limits, strict=True))
    )
    device = replace(SIGMA, force_max_n=20.0, torque_max_nm=9.0)
    session = Session(medium(force_n=6.0), device, spec)
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory)
    feeder = session.feeder(memory, is_timed=False)
    session.order(memory, mode=layout.PLAYING)
    clock = VirtualClock()
    hand = Wrist(clock)

    def must_stop() -> bool:
        feeder.fill_lookahead(3)
        return int(memory.receiver["counts"]["ticks"]) >= 2300

    serve(memory, hand, clock, must_stop)
    wrenches = np.array(hand.wrenches)
    size = np.linalg.norm(wrenches[:, :3] if name == "force" else wrenches[:, 3:], axis=1)
    peak, long = limits[:2] if name == "force" else limits[2:]
    assert size.max() <= peak * (1 + 1e-9) and size.max() > 0.99 * peak
    late = size[2000:2250]
    assert (late <= long * 1.05).all() and (late >= 0.8 * long).all()
    assert not wrenches[-1].any()


def test_reconnecting_zeroes_the_torque_too(monkeypatch: pytest.MonkeyPatch) -> None:
    hand, sent = Wrist(VirtualClock()), []

    class Pipe:
        def send(self, word: str) -> None:
            sent.append(word)

    servo._write_zero(lambda: hand, Pipe())  # type: ignore[arg-type]
    assert hand.wrenches == [(0.0,) * 6] and hand.closed == 1 and sent == [""]
