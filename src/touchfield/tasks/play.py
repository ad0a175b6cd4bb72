"""Plays a stream on a device or on a simulated hand: the receiver's half of the paper's figure 4.

The chain is stream -> decoder -> renderer -> device.

A point device is driven by a servo at 1 kHz or more in its own process, an array by a thread at its own rate.
A simulated hand may also be played offline, as fast as the machine allows and with the same forces. The log
of a playback can be written and drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.compute.threads import Progress, silent
from touchfield.devices import Device, device
from touchfield.devices.drivers.registry import (
    array_device,
    is_array_device,
    point_device,
    require_device,
)
from touchfield.devices.drivers.simulated import STIFFNESS_N_PER_M
from touchfield.devices.drivers.touch_down import touch_down
from touchfield.errors import (
    FormatError,
    InvalidArgument,
    naming_file,
    require_between,
    require_kinds,
    require_not_negative,
    require_up_to,
)
from touchfield.medium import HapticMedium, HapticScene
from touchfield.medium.trace import Trace, read_trace
from touchfield.network.live_medium import LiveEnd, LiveStream
from touchfield.network.opening import open_stream
from touchfield.options import duration_s, option
from touchfield.pipeline.array_medium import array_drives
from touchfield.pipeline.stored_map import StoredMap
from touchfield.pipeline.stream import OpenStream, stream_device
from touchfield.render.array_player import ArrayPlayer
from touchfield.render.block import FLAGS
from touchfield.render.feeder import FrameSource
from touchfield.render.offline import run_offline
from touchfield.render.player import MAX_SPEED, Player
from touchfield.render.readiness import MAX_WAIT_S
from touchfield.render.spec import RenderSpec, device_to_field
from touchfield.tasks.map_keys import TerminalKeys
from touchfield.tasks.map_play import MapWalk, SimulatedDisplay, go_to, moves_in, play_map
from touchfield.tasks.play_log import MAX_ROWS, write_log
from touchfield.tasks.play_mcap import is_mcap, require_log, write_mcap
from touchfield.viewer.interaction import InteractionView, draw_interaction

OnNote = Callable[[str], None]


_POLL_S: Final = 0.1
MAX_STALLED_FRACTION: Final = 0.01  # playback fails if a larger fraction of its ticks had no frame
_MIN_S: Final = 0.1
_MAX_S: Final = 24 * 3600.0
_MIN_PRESS_N: Final = 0.01
_PRESS_FRACTION: Final = 0.8  # fraction of the continuous limit, with a margin for friction
_DEFAULT_ROWS: Final = 1 << 16

_CHECKED_SEGMENTS: Final = 8
_LONGEST_CHECK_S: Final = 20.0
_SPEED_MARGIN: Final = (
    1.2  # required speed of the decoder over that needed: the servo also uses the processor
)


@dataclass(frozen=True)
class PlaySpec:
    """Options of a playback; raises InvalidArgument if a number is out of range.

    `device` is one of `touchfield.devices.drivers`; the default `profile` of "sim" is that of the stream.
    `trajectory` and `trace` move the simulated hand, which by default approaches, presses, slides and leaves.
    `seconds` count from the first frame; None is the length of the trajectory, or of the medium (a single
    frame, or a loop: until interrupted). `wait` is a duration, at most an hour, until the device must be
    ready. `settings` are those of the device's driver. `is_logged` keeps all rows of the log instead of the
    latest minute; `is_drawn` keeps a frame as the background of the picture. `find` and `pans` are of a map.
    """

    device: str = option(
        "sim", "sim, sim:spring, haply, openhaptics, forcedimension, bhaptics, osc:HOST:PORT, pins:PORT"
    )
    wait: str = option("30s", "How long to wait until the device is ready, such as 30s or 2min.")
    settings: str = option(
        "", "Of the device, NAME=VALUE,...: gravity=off, handedness=left (see touchfield doctor)."
    )
    profile: str | None = option(None, "Profile whose limits and actuators hold; default: the device's own.")
    trajectory: Path | None = option(None, "Where the probe goes: CSV of t_s,x_m,y_m,z_m.")
    seconds: float | None = option(None, "How long; default: the trajectory, or the medium.")
    start_s: float = option(0.0, "Where the medium begins.")
    speed: float = option(1.0, "Seconds of the medium in one of yours.")
    loop: bool = option(False, "Begin again at the end.")
    panel: str = option("front", "Of an array with two panels: front or back.")
    offline: bool = option(False, "sim: as fast as the machine runs, without a clock; the same forces.")
    is_logged: bool = False
    is_drawn: bool = False
    render: RenderSpec = field(default_factory=RenderSpec)
    trace: Path | None = option(
        None, "As --trajectory, but in the metres and axes of the scene: a recording."
    )
    find: str | None = option(None, "Of a map: start at the place of this name.")
    pans: str | None = option(
        None, "Of a map: what to do at the start, by commas: left, right, up, down, in, out, home, legend."
    )
    coarse: str | None = option(None, "Address of a live stream's coarse layer, for what is lost or late.")

    def __post_init__(self) -> None:
        require_kinds(self)
        if self.trace is not None and self.trajectory is not None:
            raise InvalidArgument("--trace and --trajectory say the same in two frames: take one of them")
        if self.seconds is not None:
            require_up_to(_MAX_S, seconds=self.seconds)
        require_not_negative(start_s=self.start_s)
        require_between(0, MAX_WAIT_S, wait=duration_s(self.wait, "wait"))
        require_up_to(MAX_SPEED, speed=self.speed)


@dataclass(frozen=True)
class Played:
    """The result of a playback.

    `statistics` has stable keys. `rows` has a row of `touchfield.render.block.COLUMNS` for each tick; it is
    None for an array. `error` is the exception that ended the playback early, after these rows.
    `device_to_field`, float64 [3, 3], is that of `touchfield.render.spec`; None for an array.
    """

    statistics: dict[str, Any]
    rows: NDArray[Any] | None
    view: InteractionView | None
    notes: tuple[str, ...]
    error: Exception | None = None
    device_to_field: Float64s | None = None

    @property
    def is_starved(self) -> bool:
        """True if too many ticks had no force because frames were late.

        The limit is `MAX_STALLED_FRACTION`.
        """
        return bool(self.statistics.get("stalled_share", 0.0) > MAX_STALLED_FRACTION)

    def checked(self) -> Played:
        """Return this result; raise the exception that ended the playback early, if any."""
        if self.error is not None:
            raise self.error
        return self

    def write_log(self, path: Path) -> tuple[str, ...]:
        """Write the log atomically, as comma-separated text (.csv) or MCAP (.mcap); return notes.

        Raises InvalidArgument for another ending, and as `touchfield.tasks.play_mcap.write_mcap` does.
        """
        require_log(path)
        rows = self._point_result(self.rows, "log")
        if is_mcap(path):
            return write_mcap(path, rows, self._point_result(self.device_to_field, "log"))
        write_log(path, rows)
        return ()

    def draw(self, path: Path) -> None:
        """Draw the picture of the interaction."""
        draw_interaction(path, self._point_result(self.view, "plot"))

    def _point_result(self, part: Any, option: str) -> Any:
        if part is None:
            raise _for_points(option)
        return part


def play(
    path: str | Path,
    spec: PlaySpec | None = None,
    report: Progress = silent,
    on_note: OnNote = lambda note: None,
    on_player: Callable[[Player], None] = lambda player: None,
) -> Played:
    """Play a ``.touch`` file on a device.

    Playback lasts until the end, for ``spec.seconds``, or until an interrupt.

    An error during playback is stored in `Played.error`, with the rows until then. `on_note` is called with
    notes during playback, and `on_player` with the player of a point device once it is ready. Raises
    InvalidArgument, DeviceError or FormatError if the device is unknown or missing, the trajectory is
    unusable, or the file or its first frame cannot be read.
    """
    spec = spec or PlaySpec()
    require_device(spec.device, spec.settings)
    with open_stream(path, on_note, spec.coarse) as stream, naming_file(stream.reader.name):
        count, seconds = (
            stream.reader.head.frame_count,
            stream.reader.head.frame_count / stream.reader.head.rate_hz,
        )
        if spec.start_s >= seconds and count > 1 and not spec.loop:
            raise InvalidArgument(
                "start_s", f"{spec.start_s:g} s", f"0 to below {seconds:g} s, the medium's end"
            )
        walk = _map_walk(stream, spec, on_note)
        if walk is not None and (is_array_device(spec.device) or _is_simulated_display(spec.device, stream)):
            return _play_map(walk, stream, spec, on_note)
        if is_array_device(spec.device):
            return _play_array(stream, spec, report, on_note)
        return _play_point(stream, Path(path).name, spec, report, on_note, on_player)


def _play_point(
    stream: OpenStream,
    name: str,
    spec: PlaySpec,
    report: Progress,
    on_note: OnNote,
    on_player: Callable[[Player], None],
) -> Played:
    """Play a stream on a point device."""
    medium_or_scene: HapticMedium | HapticScene = stream.scene or stream.medium
    if stream.reader.head.device_type == 2:
        found = f"a stream for the array {stream.reader.head.device_name}"
        array, point = "(bhaptics, osc, pins)", "(--device phantom-omni)"
        hint = f"Play it on an array {array}, or encode the scene for a point {point}."
        raise InvalidArgument(name, found, "one in space", hint)
    trajectory = _read_trajectory(spec, stream)
    choice = point_device(spec.device, trajectory, spec.settings)
    profile_name = spec.profile or choice.profile
    profile = device(profile_name) if profile_name else stream_device(stream)
    if choice.is_simulated:
        profile = replace(profile, axes=medium_or_scene.axes)
        spec = replace(spec, render=replace(spec.render, up="lattice"))  # moves in the axes of the field
        if not trajectory:
            trajectory = _probe(spec, profile, stream.medium[:1] if stream.is_live else medium_or_scene)
        choice = point_device(spec.device, trajectory, spec.settings)
    elif spec.offline:
        raise InvalidArgument(f"--offline works with --device sim, not with {choice.name}")
    seconds = spec.seconds  # None: to the end of the medium, or without limit if it has no end
    if seconds is None and trajectory is not None:
        seconds = max(float(trajectory.times_s[-1]), _MIN_S)
    times: dict[str, Any] = {"loop": spec.loop, "speed": spec.speed, "start_s": spec.start_s}
    if spec.offline:
        offline = run_offline(
            medium_or_scene, profile, choice.opener, spec.render, seconds=seconds, keeps_error=True, **times
        )
        clock_keys = "jitter", "lateness"  # without a clock they have no meaning
        statistics = {
            key: value for key, value in offline.statistics.items() if not key.startswith(clock_keys)
        }
        run = _Run(statistics, offline.log, offline.notes, offline.error)
    else:
        log_rows = MAX_ROWS if spec.is_logged else _DEFAULT_ROWS
        player = Player(
            medium_or_scene, profile, choice.opener, spec.render,
            log_rows=log_rows, wait_s=duration_s(spec.wait, "wait"), on_note=on_note, **times,
        )  # fmt: skip
        on_player(player)
        run = _run_player(player, seconds, report, on_note, stream)
    friction = spec.render.friction if spec.render.friction is not None else medium_or_scene.friction
    figures = _point_figures(run, spec, profile, friction)
    view = None if run.error is not None else _interaction_view(name, run.rows, spec, profile, stream)
    axes = device_to_field(spec.render, profile, medium_or_scene.axes)
    return Played(figures, run.rows, view, run.notes, run.error, axes)


class _Run(NamedTuple):
    """Results of a servo, with a clock or offline: figures, rows of the log, notes, and its error."""

    statistics: dict[str, Any]
    rows: NDArray[Any]
    notes: tuple[str, ...]
    error: Exception | None


def _read_trajectory(spec: PlaySpec, stream: OpenStream) -> Trace | None:
    """Read the positions of the simulated hand, hand metres; None if no file is named."""
    trajectory = None if spec.trajectory is None else _read_path("--trajectory", spec.trajectory)
    if spec.trace is None:
        return trajectory
    recorded = _read_path("--trace", spec.trace)
    return Trace(recorded.times_s, stream.placement.to_hand(recorded.positions_m))


def _read_path(option_name: str, path: Path) -> Trace:
    if is_mcap(path):
        hint = "touchfield play --log OUT.csv writes positions that are read."
        raise InvalidArgument(option_name, f"{path}, an MCAP file", "comma-separated text", hint)
    return read_trace(path)


def _run_player(
    player: Player, seconds: float | None, report: Progress, on_note: OnNote, stream: OpenStream
) -> _Run:
    """Run the servo until the end; the log starts at the first tick that ran."""
    error: Exception | None = None
    with player:
        player.play()
        try:
            _wait(player, seconds, report, on_note, stream)
        except Exception as failed:
            if failed is not player.error:
                raise
            error = failed
    error = error or player.error
    statistics, rows, notes = player.statistics(), player.log(), player.notes
    first = np.append(np.flatnonzero(rows["flags"]), len(rows))[0]
    rows = rows[first:].copy()
    rows["time_s"] -= rows["time_s"][:1]
    if isinstance(error, LiveEnd) and statistics["frames_used"]:
        return _Run(_before_end(statistics, rows), rows, (*notes, str(error)), None)
    return _Run(statistics, rows, notes, error)


def _point_figures(run: _Run, spec: PlaySpec, profile: Device, friction: float) -> dict[str, Any]:
    """Return the figures of a playback on a point device; the keys are stable."""
    rows = run.rows
    force_n, has_contact = np.linalg.norm(rows["force_n"], axis=1), rows["field_force_n"].any(axis=1)
    return {
        "device": spec.device,
        "profile": profile.name,
        "friction": friction,
        "contact_share": float(has_contact.mean()) if len(rows) else 0.0,
        "greatest_force_n": float(force_n.max(initial=0.0)),
        "last_force_n": float(force_n[-1]) if len(rows) else 0.0,
        **run.statistics,
    }


def _interaction_view(
    name: str, rows: NDArray[Any], spec: PlaySpec, profile: Device, stream: OpenStream
) -> InteractionView:
    """Return the content of the picture of a playback."""
    render, medium = spec.render, stream.medium
    background = medium[0 if stream.is_live else len(medium) // 2] if spec.is_drawn else None
    ticks = f"{len(rows)} ticks of {1e3 / render.rate_hz:g} ms"
    caption = f"{spec.device} with the limits of {profile.name}, {ticks}"
    peak_n = render.peak_n or profile.force_max_n
    continuous_n = render.continuous_n or profile.force_continuous_n
    return InteractionView(name, caption, medium.axes, rows, peak_n, continuous_n, background)


def _before_end(statistics: dict[str, Any], rows: NDArray[Any]) -> dict[str, Any]:
    """Return the statistics without the stalled ticks after the last frame of a live stream."""
    running = np.flatnonzero(rows["flags"] & FLAGS["running"])
    stalled_after_end = (
        int(np.count_nonzero(rows["flags"][running[-1] :] & FLAGS["stalled"])) if len(running) else 0
    )
    stalled, fraction = statistics["stalled_ticks"], statistics["stalled_share"]
    if not stalled_after_end or not fraction:
        return statistics
    remaining = max(stalled - stalled_after_end, 0)
    return {
        **statistics,
        "stalled_ticks": remaining,
        "stalled_share": remaining / max(stalled / fraction - stalled_after_end, 1),
    }


def _probe(spec: PlaySpec, profile: Device, field_of: HapticMedium | HapticScene) -> Trace:
    """Return the default trajectory of a hand, which presses no harder than the device can sustain."""
    continuous_n = spec.render.continuous_n or profile.force_continuous_n or math.inf
    max_press_n = max(_PRESS_FRACTION * continuous_n / max(spec.render.force_scale, 1e-3), _MIN_PRESS_N)
    stiffness = STIFFNESS_N_PER_M if spec.device.strip().lower().endswith(":spring") else math.inf
    times = {"start_s": spec.start_s, "speed": spec.speed}
    return touch_down(field_of, stiffness_n_per_m=stiffness, force_max_n=max_press_n, **times)


def _wait(
    player: Player | ArrayPlayer, seconds: float | None, report: Progress, on_note: OnNote, stream: OpenStream
) -> None:
    """Wait for the end of the time or of the medium, or for an interrupt; pass on notes and progress."""
    limit_s = math.inf if seconds is None else seconds
    waited, reported = 0.0, set(player.notes)
    try:
        while waited < limit_s and not player.wait(min(_POLL_S, limit_s - waited)):
            waited += _POLL_S
            if isinstance(stream, LiveStream) and isinstance(player, Player):
                stream.keep_up(player)
            for note in player.notes:
                if note not in reported:
                    reported.add(note)
                    on_note(note)
            if seconds is not None:
                report(int(waited), math.ceil(seconds))
    except KeyboardInterrupt:
        return


def _play_array(stream: OpenStream, spec: PlaySpec, report: Progress, on_note: OnNote) -> Played:
    if spec.offline or spec.trajectory is not None or spec.trace is not None:
        raise _for_points("offline" if spec.offline else "trajectory" if spec.trajectory else "trace")
    if spec.is_logged:
        raise _for_points("log or --plot")
    if spec.settings:
        raise _for_points("settings")
    declared = stream_device(stream)
    driver = array_device(spec.device, device(spec.profile) if spec.profile else None, declared)
    if declared.is_array and declared.name != driver.profile.name:
        change = f"for {declared.name}, and is shown on {driver.profile.name}"
        on_note(f"The stream was made {change}; --profile takes another.")
    drives = array_drives(stream, driver.profile, spec.panel)
    times: dict[str, Any] = {"loop": spec.loop, "speed": spec.speed, "start_s": spec.start_s}
    times["is_blended"] = spec.render.blend
    wait_s = duration_s(spec.wait, "wait")
    with ArrayPlayer(drives, driver, **times, wait_s=wait_s, on_note=on_note) as player:
        try:
            while not player.wait_started(_POLL_S):  # preparation does not count as playing time
                pass
            _wait(player, spec.seconds, report, on_note, stream)
        except (KeyboardInterrupt, LiveEnd):
            pass
    error, figures = player.error, player.statistics()
    if error is not None and not (isinstance(error, LiveEnd) and figures["sent"]):
        raise error
    notes = (*player.notes, *([] if error is None else [str(error)]))
    figures["stalled_share"] = figures["stalled"] / max(figures["sent"], 1)
    return Played({"device": spec.device, "profile": driver.profile.name, **figures}, None, None, notes)


# -- maps --------------------------------------------------------------------------------------------------
def _is_simulated_display(name: str, stream: OpenStream) -> bool:
    """True if a stream for an array is played without a device."""
    return name.strip().lower() == "sim" and stream.reader.head.device_type == 2


def _map_walk(stream: OpenStream, spec: PlaySpec, on_note: OnNote) -> MapWalk | None:
    """Return the start of the map of a stream, or None if it has none or its map cannot be read."""
    options = {"--find": spec.find, "--pans": spec.pans}
    requested = [name for name, value in options.items() if value is not None]
    name = stream.reader.name
    if stream.is_live or not stream.reader.has_map:
        if requested:
            found = f"{name}, which has no zoom levels and no names"
            hint = "Make one by: touchfield map SOURCE OUT.touch --device graphiti, or another pin display."
            raise InvalidArgument(requested[0], found, "a map for a pin display", hint)
        return None
    try:
        record = stream.reader.read_map()
    except FormatError as error:
        if requested:
            raise
        on_note(f"Only the whole map is shown, as its zoom levels cannot be read: {error}")
        return None
    return None if record is None else MapWalk(StoredMap(record, name))


def _play_map(walk: MapWalk, stream: OpenStream, spec: PlaySpec, on_note: OnNote) -> Played:
    """Play a map on a display, or on none."""
    moves = moves_in(spec.pans or "")
    if spec.trajectory is not None or spec.trace is not None:
        raise _for_points("trajectory" if spec.trajectory else "trace")
    if spec.is_logged:
        raise _for_points("log or --plot")
    declared = stream_device(stream)
    profile = device(spec.profile) if spec.profile else None
    if is_array_device(spec.device):
        if spec.offline:
            raise InvalidArgument(f"--offline works with --device sim, not with {spec.device}")
        driver = array_device(spec.device, profile, declared)
    else:
        if spec.render != RenderSpec():
            found = "options of the renderer, of tools or of materials"
            raise InvalidArgument("--device sim", found, "none with a map, whose display has no forces")
        driver = SimulatedDisplay(profile or declared)
    columns, rows, _ = driver.profile.lattice
    is_other = (rows, columns) != (walk.stored.record.rows, walk.stored.record.columns)
    if is_other and is_array_device(spec.device) and not (moves or spec.find):
        on_note(
            f"{driver.profile.name} has other pins than the map: it shows the whole map, without zooming."
        )
        return _play_array(stream, spec, silent, on_note)
    for line in go_to(walk, spec.find) if spec.find is not None else ():
        on_note(line)
    seconds = spec.seconds
    if spec.offline or (isinstance(driver, SimulatedDisplay) and not TerminalKeys().is_available):
        seconds = 0.0  # nobody can do more than the moves
    wait_s = duration_s(spec.wait, "wait")
    figures = play_map(walk, driver, moves, panel=spec.panel, seconds=seconds, wait_s=wait_s, on_note=on_note)
    notes = tuple(figures.pop("device_notes"))
    return Played({"device": spec.device, "profile": driver.profile.name, **figures}, None, None, notes)


def _for_points(option: str) -> InvalidArgument:
    return InvalidArgument(f"--{option} works with a point device (type 1), not with an array of actuators")


def check_play(
    path: str | Path, speed: float = 1.0, clock_s: Callable[[], float] = perf_counter
) -> dict[str, Any]:
    """Check whether this machine can decode a stream in time.

    Decodes up to 8 evenly spaced segments for at most 20 s, and compares the time with their duration.
    ``greatest_speed`` is the highest speed that can be played in time; ``can_play`` is for the given speed.
    Raises InvalidArgument if the speed is not positive, TouchfieldError if the file cannot be read.
    """
    require_up_to(MAX_SPEED, speed=speed)
    with open_stream(path) as stream:
        source = FrameSource(stream.scene or stream.medium)
        count = source.frame_count
        starts = [*(source.starts or range(0, count, max(1, count // _CHECKED_SEGMENTS)))]
        checked = range(min(_CHECKED_SEGMENTS, len(starts)))
        checked_starts = [starts[i * len(starts) // len(checked)] for i in checked]
        source.prepare(checked_starts[-1])  # load or compile code before the time starts
        start_s, frames = clock_s(), 0
        for first in checked_starts:
            stop = min((at for at in starts if at > first), default=count)
            for frame in range(first, stop):
                if frames and clock_s() - start_s > _LONGEST_CHECK_S:
                    break
                source.prepare(frame)
                frames += 1
        took_s = max(clock_s() - start_s, 1e-9)
    needed_hz = source.rate_hz * speed if count > 1 else 0.0
    greatest = frames / took_s / source.rate_hz / _SPEED_MARGIN
    return {
        "frames_decoded": frames,
        "decode_s": took_s,
        "decoded_rate_hz": frames / took_s,
        "needed_rate_hz": needed_hz,
        "greatest_speed": greatest,
        "can_play": count == 1 or greatest >= speed,
    }
