"""stream -> decoder -> renderer -> device: the receiver's half of figure 4, and what it left behind.

A point is played by a servo at 1 kHz or more in a process of its own, an array by a thread at its own rate; a
simulated hand may also be played offline, as fast as the machine goes and with the same forces.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.atomic import atomic_path
from touchfield.compute.threads import Report, silent
from touchfield.devices import Device, device
from touchfield.devices.drivers.registry import array_device, is_array_device, point_device
from touchfield.devices.drivers.simulated import STIFFNESS_N_PER_M
from touchfield.devices.drivers.touch_down import touch_down
from touchfield.errors import InvalidArgument, require_kinds, require_not_negative, require_up_to
from touchfield.medium import HapticMedium, HapticScene
from touchfield.medium.trace import Trace, read_trace
from touchfield.network.live_medium import LiveEnd, LiveStream
from touchfield.options import option
from touchfield.pipeline.array_medium import array_drives, stream_device
from touchfield.pipeline.decoding import OpenStream, open_stream
from touchfield.render.array_player import ArrayPlayer
from touchfield.render.block import FLAGS
from touchfield.render.feeder import FrameSource
from touchfield.render.offline import run_offline
from touchfield.render.player import FASTEST, Player
from touchfield.render.spec import RenderSpec
from touchfield.viewer.interaction import InteractionView, draw_interaction

Tell = Callable[[str], None]


_LOOK_S: Final = 0.1
MOST_NOTHING: Final = (
    0.01  # of the ticks of a play: where more had nothing, as frames came too late, it has failed
)
_LEAST_S: Final = 0.1
_LONGEST_S: Final = 24 * 3600.0
_LEAST_PRESS_N: Final = 0.01
_SHARE_HELD: Final = 0.8  # of the continuous limit, so that friction has room
_MOST_ROWS: Final = 1 << 22  # 70 minutes at 1 kHz, 1 GB
_FEW_ROWS: Final = 1 << 16

_CHECKED_SEGMENTS: Final = 8
_LONGEST_CHECK_S: Final = 20.0
_SPARE: Final = (
    1.2  # so much quicker than needed the decoder must be: the servo wants its share of the processor
)


@dataclass(frozen=True)
class PlaySpec:
    """Everything asked of a play; InvalidArgument if a number is out of range.

    `device` is one of `touchfield.devices.drivers`; `profile` of "sim" is by default that of the stream.
    `trajectory` and `trace` are of the simulated hand, which else comes, presses, slides and leaves.
    `seconds` count from the first frame on; None: the trajectory, or else the medium (a single frame, or a
    loop: until interrupted). `is_logged`: all rows of the log are wanted, else the latest minute; `is_drawn`:
    a frame is wanted behind a picture.
    """

    device: str = option(
        "sim", "sim, sim:spring, haply, openhaptics, forcedimension, bhaptics, osc:HOST:PORT, pins:PORT"
    )
    profile: str | None = option(None, "Profile whose limits and actuators hold; default: the device's own.")
    trajectory: Path | None = option(None, "Where the probe goes: CSV of t_s,x_m,y_m,z_m.")
    seconds: float | None = option(None, "How long; default: the trajectory, or the medium.")
    start_s: float = option(0.0, "Where the medium begins.")
    speed: float = option(1.0, "Seconds of the medium in one of yours.")
    loop: bool = option(False, "Begin again at the end.")
    panel: str = option("front", "Of an array with two panels: front or back.")
    offline: bool = option(False, "sim: no clock, as fast as it goes; the same forces.")
    is_logged: bool = False
    is_drawn: bool = False
    render: RenderSpec = field(default_factory=RenderSpec)
    trace: Path | None = option(
        None, "As --trajectory, but in the metres and axes of the scene: a recording."
    )
    coarse: str | None = option(None, "Address of a live stream's coarse layer, for what is lost or late.")

    def __post_init__(self) -> None:
        require_kinds(self)
        if self.trace is not None and self.trajectory is not None:
            raise InvalidArgument("--trace and --trajectory say the same in two frames: take one of them")
        if self.seconds is not None:
            require_up_to(_LONGEST_S, seconds=self.seconds)
        require_not_negative(start_s=self.start_s)
        require_up_to(FASTEST, speed=self.speed)


@dataclass(frozen=True)
class Played:
    """The traces of a play.

    `statistics` have stable keys; `rows` are of `touchfield.render.block.COLUMNS`, a row a tick, None for an
    array; `error` is what ended it half way: what was felt until then is here.
    """

    statistics: dict[str, Any]
    rows: NDArray[Any] | None
    view: InteractionView | None
    notes: tuple[str, ...]
    error: Exception | None = None

    @property
    def is_starved(self) -> bool:
        """True where more of it than `MOST_NOTHING` was nothing, because frames came too late."""
        return bool(self.statistics.get("stalled_share", 0.0) > MOST_NOTHING)

    def checked(self) -> Played:
        """Itself, or the exception that ended it half way, raised."""
        if self.error is not None:
            raise self.error
        return self

    def write_log(self, path: Path) -> None:
        """Write the log as comma-separated text, whole or not at all."""
        rows = self._felt(self.rows, "log")
        words = {
            flags: "+".join(name for name, bit in FLAGS.items() if flags & bit) or "idle"
            for flags in np.unique(rows["flags"]).tolist()
        }
        with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
            file.write(",".join(COLUMNS) + "\n")
            for first in range(0, len(rows), _ROWS_AT_ONCE):
                some = rows[first : first + _ROWS_AT_ONCE]
                numbers = np.column_stack([some[name] for name in _LOGGED]) + 0.0
                for row, buttons, flags in zip(
                    numbers.tolist(), some["buttons"].tolist(), some["flags"].tolist()
                ):
                    file.write(",".join(f"{value:.9g}" for value in row) + f",{buttons},{words[flags]}\n")

    def draw(self, path: Path) -> None:
        """The picture of the interaction."""
        draw_interaction(path, self._felt(self.view, "plot"))

    def _felt(self, part: Any, option: str) -> Any:
        if part is None:
            raise _for_points(option)
        return part


def play(
    path: str | Path,
    spec: PlaySpec | None = None,
    report: Report = silent,
    tell: Tell = lambda note: None,
    watch: Callable[[Player], None] = lambda player: None,
) -> Played:
    """Play a ``.touch`` file on a device until it is over, `seconds` are, or an interrupt comes.

    An error half way is in `Played.error`, beside what was felt until then; `tell` gets notes while it plays,
    `watch` the player of a point device once it is there. InvalidArgument or DeviceError or FormatError if
    the device is unknown or not there, the trajectory is unusable, or the file or its first frame cannot be
    read.
    """
    spec = spec or PlaySpec()
    with open_stream(path, tell, spec.coarse) as stream:
        count, seconds = (
            stream.reader.head.frame_count,
            stream.reader.head.frame_count / stream.reader.head.rate_hz,
        )
        if spec.start_s >= seconds and count > 1 and not spec.loop:
            raise InvalidArgument(
                "start_s", f"{spec.start_s:g} s", f"0 to below {seconds:g} s, the medium's end"
            )
        if is_array_device(spec.device):
            return _play_array(stream, spec, report, tell)
        return _play_point(stream, Path(path).name, spec, report, tell, watch)


def _play_point(
    stream: OpenStream, name: str, spec: PlaySpec, report: Report, tell: Tell, watch: Callable[[Player], None]
) -> Played:
    field_of: HapticMedium | HapticScene = stream.scene or stream.medium
    if stream.reader.head.device_type == 2:
        mend = (
            "Play it on an array (bhaptics, osc, pins), or encode the scene for a point (--device "
            "phantom-omni)."
        )
        raise InvalidArgument(
            name, f"a stream for the array {stream.reader.head.device_name}", "one in space", mend
        )
    trajectory = None if spec.trajectory is None else read_trace(spec.trajectory)
    if spec.trace is not None:
        recorded = read_trace(spec.trace)
        trajectory = Trace(recorded.times_s, stream.placement.to_hand(recorded.positions_m))
    choice = point_device(spec.device, trajectory)
    named = spec.profile or choice.profile
    profile = device(named) if named else stream_device(stream)
    if choice.is_simulated:
        profile = replace(profile, axes=field_of.axes)
        spec = replace(spec, render=replace(spec.render, up="lattice"))  # it moves in the field's own axes
        trajectory = trajectory or _probe(spec, profile, stream.medium[:1] if stream.is_live else field_of)
        choice = point_device(spec.device, trajectory)
    elif spec.offline:
        raise InvalidArgument(f"--offline works with --device sim, not with {choice.name}")
    seconds = spec.seconds  # None: to the end of the medium, or for ever where it has none
    if seconds is None and trajectory is not None:
        seconds = max(float(trajectory.times_s[-1]), _LEAST_S)
    times: dict[str, Any] = {"loop": spec.loop, "speed": spec.speed, "start_s": spec.start_s}
    if spec.offline:
        error: Exception | None
        run = run_offline(
            field_of, profile, choice.opener, spec.render, seconds=seconds, keeps_error=True, **times
        )
        rows, notes, error = run.log, run.notes, run.error
        of_a_clock = "jitter", "lateness"  # that it has not
        statistics = {key: value for key, value in run.statistics.items() if not key.startswith(of_a_clock)}
    else:
        log_rows = _MOST_ROWS if spec.is_logged else _FEW_ROWS
        player = Player(field_of, profile, choice.opener, spec.render, log_rows=log_rows, **times)
        watch(player)
        error = None
        with player:
            player.play()
            try:
                _wait(player, seconds, report, tell, stream)
            except Exception as failed:
                if failed is not player.error:
                    raise
                error = failed
        error = error or player.error
        statistics, rows, notes = player.statistics(), player.log(), player.notes
        rows = rows[
            np.append(np.flatnonzero(rows["flags"]), len(rows))[0] :
        ].copy()  # from the first that ran
        rows["time_s"] -= rows["time_s"][:1]
        if isinstance(error, LiveEnd) and statistics["frames_used"]:
            notes, error, statistics = (*notes, str(error)), None, _before_end(statistics, rows)
    friction = spec.render.friction if spec.render.friction is not None else field_of.friction
    put, touched = np.linalg.norm(rows["force_n"], axis=1), rows["field_force_n"].any(axis=1)
    figures = {
        "device": spec.device,
        "profile": profile.name,
        "friction": friction,
        "contact_share": float(touched.mean()) if len(rows) else 0.0,
        "greatest_force_n": float(put.max(initial=0.0)),
        "last_force_n": float(put[-1]) if len(rows) else 0.0,
        **statistics,
    }
    if error is not None:
        return Played(figures, rows, None, notes, error)
    render, medium = spec.render, stream.medium
    drawn = medium[0 if stream.is_live else len(medium) // 2] if spec.is_drawn else None
    caption = (
        f"{spec.device} with the limits of {profile.name}, {len(rows)} ticks of {1e3 / render.rate_hz:g} ms"
    )
    peak_n, continuous_n = (
        render.peak_n or profile.force_max_n,
        render.continuous_n or profile.force_continuous_n,
    )
    view = InteractionView(name, caption, medium.axes, rows, peak_n, continuous_n, drawn)
    return Played(figures, rows, view, notes)


def _before_end(statistics: dict[str, Any], rows: NDArray[Any]) -> dict[str, Any]:
    """The statistics without the ticks behind the last frame of a live stream, which nobody missed."""
    running = np.flatnonzero(rows["flags"] & FLAGS["running"])
    behind = int(np.count_nonzero(rows["flags"][running[-1] :] & FLAGS["stalled"])) if len(running) else 0
    stalled, share = statistics["stalled_ticks"], statistics["stalled_share"]
    if not behind or not share:
        return statistics
    left = max(stalled - behind, 0)
    return {**statistics, "stalled_ticks": left, "stalled_share": left / max(stalled / share - behind, 1)}


def _probe(spec: PlaySpec, profile: Device, field_of: HapticMedium | HapticScene) -> Trace:
    """A trajectory for a hand that was given none; it presses no harder than the device can hold for long."""
    held_n = spec.render.continuous_n or profile.force_continuous_n or math.inf
    most_n = max(_SHARE_HELD * held_n / max(spec.render.force_scale, 1e-3), _LEAST_PRESS_N)
    stiffness = STIFFNESS_N_PER_M if spec.device.strip().lower().endswith(":spring") else math.inf
    times = {"start_s": spec.start_s, "speed": spec.speed}
    return touch_down(field_of, stiffness_n_per_m=stiffness, force_max_n=most_n, **times)


def _wait(
    player: Player | ArrayPlayer, seconds: float | None, report: Report, tell: Tell, stream: OpenStream
) -> None:
    """Until the time is over, the medium has ended, or the user interrupts: what was felt until then is kept."""
    ends = math.inf if seconds is None else seconds
    waited, told = 0.0, set(player.notes)
    try:
        while waited < ends and not player.wait(min(_LOOK_S, ends - waited)):
            waited += _LOOK_S
            if isinstance(stream, LiveStream) and isinstance(player, Player):
                stream.keep_up(player)
            for note in player.notes:
                if note not in told:
                    told.add(note)
                    tell(note)
            if seconds is not None:
                report(int(waited), math.ceil(seconds))
    except KeyboardInterrupt:
        return


def _play_array(stream: OpenStream, spec: PlaySpec, report: Report, tell: Tell) -> Played:
    if spec.offline or spec.trajectory is not None or spec.trace is not None:
        raise _for_points("offline" if spec.offline else "trajectory" if spec.trajectory else "trace")
    if spec.is_logged:
        raise _for_points("log or --plot")
    own = stream_device(stream)
    chosen = array_device(spec.device, device(spec.profile) if spec.profile else None, own)
    if own.is_array and own.name != chosen.profile.name:
        tell(
            f"The stream was made for {own.name}, and is shown on {chosen.profile.name}; --profile takes "
            "another."
        )
    drives = array_drives(stream, chosen.profile, spec.panel)
    with ArrayPlayer(drives, chosen, loop=spec.loop, speed=spec.speed, start_s=spec.start_s) as player:
        try:
            while not player.wait_begun(_LOOK_S):  # preparation is no playing time
                pass
            _wait(player, spec.seconds, report, tell, stream)
        except (KeyboardInterrupt, LiveEnd):
            pass
    error, figures = player.error, player.statistics()
    if error is not None and not (isinstance(error, LiveEnd) and figures["sent"]):
        raise error
    notes = (*player.notes, *([] if error is None else [str(error)]))
    figures["stalled_share"] = figures["stalled"] / max(figures["sent"], 1)
    return Played({"device": spec.device, "profile": chosen.profile.name, **figures}, None, None, notes)


def _for_points(option: str) -> InvalidArgument:
    return InvalidArgument(f"--{option} works with a point device (type 1), not with an array of actuators")


def check_play(
    path: str | Path, speed: float = 1.0, clock_s: Callable[[], float] = perf_counter
) -> dict[str, Any]:
    """Decode up to 8 segments, evenly spread, for at most 20 s, and compare with the time that they last.

    ``greatest_speed`` is the one that can be played in time, and ``can_play`` is of the speed asked for.
    InvalidArgument if that is not positive, TouchfieldError if the file cannot be read.
    """
    require_up_to(FASTEST, speed=speed)
    with open_stream(path) as stream:
        source = FrameSource(stream.scene or stream.medium)
        count = source.frame_count
        starts = [*(source.starts or range(0, count, max(1, count // _CHECKED_SEGMENTS)))]
        checked = range(min(_CHECKED_SEGMENTS, len(starts)))
        chosen = [starts[i * len(starts) // len(checked)] for i in checked]
        source.prepare(chosen[-1])  # code is loaded or compiled first, and is no part of it
        begun, frames = clock_s(), 0
        for first in chosen:
            stop = min((at for at in starts if at > first), default=count)
            for frame in range(first, stop):
                if frames and clock_s() - begun > _LONGEST_CHECK_S:
                    break
                source.prepare(frame)
                frames += 1
        took_s = max(clock_s() - begun, 1e-9)
    needed_hz = source.rate_hz * speed if count > 1 else 0.0
    greatest = frames / took_s / source.rate_hz / _SPARE
    return {
        "frames_decoded": frames,
        "decode_s": took_s,
        "decoded_rate_hz": frames / took_s,
        "needed_rate_hz": needed_hz,
        "greatest_speed": greatest,
        "can_play": count == 1 or greatest >= speed,
    }


COLUMNS: Final = (
    "t_s", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s",
    "field_x_n", "field_y_n", "field_z_n", "friction_x_n", "friction_y_n", "friction_z_n",
    "force_x_n", "force_y_n", "force_z_n",
    "qw", "qx", "qy", "qz", "field_torque_x_nm", "field_torque_y_nm", "field_torque_z_nm",
    "torque_x_nm", "torque_y_nm", "torque_z_nm", "gripper_m", "media_s", "buttons", "state",
)  # fmt: skip
"""Seconds since the first tick; the hand, the field's force and friction in the field's axes; the force that
the device got, in its own; how the grip was turned, in the device's axes; the torque of the field and that
which the device got, likewise; how far the gripper was open; the time of the medium; the buttons (bit n is
button n); and what was going on, words joined by +."""

_LOGGED: Final = (
    "time_s", "position_m", "velocity_m_s", "field_force_n", "friction_n", "force_n", "orientation",
    "field_torque_nm", "torque_nm", "gripper_m", "media_s",
)  # fmt: skip
_ROWS_AT_ONCE: Final = 1 << 14
