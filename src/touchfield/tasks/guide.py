"""Guides a wearer with a depth camera and a vest: command `guide`.

    frames (a thread) -> `Guide` (this thread) -> drives (a thread) -> device, log

It is no mobility aid and replaces no cane. What is not known is never shown as free: without a new frame for
`GuideSpec.timeout_s`, for a blind frame, and for one that reaches the actuators more than `MAX_DELAY_S` after
it arrived, the warning pattern is shown for at least `WARNING_S`. The thread of the drives does not wait for
the others, so that it warns while they hang; if the program hangs or dies, the device switches off by itself.
"""

from __future__ import annotations

import csv
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TextIO

import numpy as np

from touchfield.arrays import Float32s
from touchfield.atomic import atomic_path
from touchfield.devices import device
from touchfield.devices.drivers.registry import array_device, array_kinds, is_array_device
from touchfield.errors import InvalidArgument, SourceError, require_between, require_kinds, require_up_to
from touchfield.guidance.directions import DIRECTIONS
from touchfield.guidance.feed import CameraFeed, Feed, ReplayFeed, is_end
from touchfield.guidance.guide import Guide, Situation, State
from touchfield.guidance.pattern import Patterns
from touchfield.guidance.spec import GuideSpec
from touchfield.options import duration_s, option
from touchfield.render.array_player import DEFAULT_RATE_HZ
from touchfield.render.readiness import MAX_WAIT_S, open_when_ready
from touchfield.sources.depth.capture import CapturedSequence, open_capture
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.render.array_player import ArrayDevice
    from touchfield.sources.camera import DepthSequence

OnNote = Callable[[str], None]

MAX_DELAY_S: Final = 0.1
WARNING_S: Final = 0.3
FAREWELL_S: Final = 1.0
"""How long the warning is shown when a camera ends."""
MAX_ROWS: Final = 1 << 20
"""Rows of a log: nine hours."""
_MAX_PERIOD_S: Final = 0.05
_MAX_SECONDS: Final = 24 * 3600.0
_BIN_S, _BINS = 0.0005, 4000
NOTICE: Final = (
    "This is no mobility aid and replaces no cane: see docs/how-to/guide.md for what it does not see."
)


@dataclass(frozen=True)
class GuideRun:
    """Options of a run; raises `InvalidArgument` if a number is out of range.

    `device` is a driver of an array, or the name of a profile, which takes the driver of that profile. With
    `offline`, each frame of a recorded sequence is evaluated without a clock, and no device is opened.
    """

    device: str = option("tactsuit-x40", "tactsuit-x40, bhaptics[:HOST:PORT], osc:HOST:PORT.")
    profile: str | None = option(None, "Profile with the actuators; default: the device's own.")
    wait: str = option("30s", "How long to wait until the device is ready, such as 30s or 2min.")
    seconds: float | None = option(None, "How long; default: to the end of the source.")
    offline: bool = option(False, "Folders: each frame as fast as the machine runs, without a device.")
    guide: GuideSpec = field(default_factory=GuideSpec)

    def __post_init__(self) -> None:
        require_kinds(self)
        require_between(0, MAX_WAIT_S, wait=duration_s(self.wait, "wait"))
        if self.seconds is not None:
            require_up_to(_MAX_SECONDS, seconds=self.seconds)


class Shown(NamedTuple):
    """What the actuators show: reason of a warning or "", the situation, and its frame."""

    warning: str
    situation: Situation | None
    frame: int
    drives: Float32s


@dataclass
class Counts:
    """Counts of a run; `summary` has stable keys."""

    frames: int = 0
    dropped: int = 0
    unreadable: int = 0
    other_size: int = 0
    evaluated: int = 0
    late: int = 0
    blind: int = 0
    without_ground: int = 0
    timeouts: int = 0
    warning_s: float = 0.0
    pose_jumps: int = 0
    states: list[int] = field(default_factory=lambda: [0, 0, 0])
    steps: int = 0
    drops: int = 0
    max_delay_s: float = 0.0
    _delays: Any = field(default_factory=lambda: np.zeros(_BINS + 1, np.int64))

    def add(self, situation: Situation) -> None:
        """Count an evaluated frame."""
        self.evaluated += 1
        self.blind += situation.is_blind
        self.without_ground += not (situation.is_blind or situation.ground.is_seen)
        for state in situation.states:
            self.states[state] += 1
        self.steps += math.isfinite(situation.ahead.step_m)
        self.drops += math.isfinite(situation.ahead.drop_m)

    def add_delay(self, seconds: float) -> None:
        """Count the time from the arrival of a frame to the actuators."""
        self._delays[min(int(seconds / _BIN_S), _BINS)] += 1
        self.max_delay_s = max(self.max_delay_s, seconds)

    def delay_ms(self, percent: float) -> float | None:
        """Return a percentile of the delay, milliseconds, rounded up to 0.5; None without frames."""
        total = int(self._delays.sum())
        if not total:
            return None
        rank = int(np.searchsorted(np.cumsum(self._delays), math.ceil(total * percent / 100)))
        return 1e3 * min(_BIN_S * (rank + 1), self.max_delay_s)

    def summary(self) -> dict[str, Any]:
        """Return the counts as a dictionary."""
        directions = max(sum(self.states), 1)
        names = (
            "frames",
            "dropped",
            "unreadable",
            "other_size",
            "evaluated",
            "late",
            "blind",
            "without_ground",
            "timeouts",
        )
        return {
            **{name: getattr(self, name) for name in names},
            "warning_s": self.warning_s,
            "pose_jumps": self.pose_jumps,
            **{f"{state.name.lower()}_share": self.states[state] / directions for state in State},
            "frames_with_step": self.steps,
            "frames_with_drop": self.drops,
            "delay_p50_ms": self.delay_ms(50),
            "delay_p99_ms": self.delay_ms(99),
            "delay_max_ms": 1e3 * self.max_delay_s if self.max_delay_s else None,
        }


def guide(
    source: str | Path,
    run: GuideRun | None = None,
    options: SourceOptions | None = None,
    log: Path | None = None,
    on_note: OnNote = lambda note: None,
    on_shown: Callable[[float, Shown], None] = lambda time_s, shown: None,
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Guide with a source until its end, for `GuideRun.seconds`, or until an interrupt.

    Parameters
    ----------
    source : str or Path
        A recorded depth sequence; ``camera:N``, ``watch:FOLDER`` or ``-`` (`sources.depth.capture`).
    run : GuideRun, optional
    options : SourceOptions, optional
        How the source is read.
    log : Path, optional
        CSV file to write: a row for each frame and each warning.
    on_note : callable
        Called with notes during the run.
    on_shown : callable
        ``on_shown(time_s, shown)``: called with each row of the log, from the thread of the drives.

    Returns
    -------
    (dict, tuple of str)
        Figures with stable keys, and notes.

    Raises `SourceError` if there are no depth pictures, `InvalidArgument` or `DeviceError` for a device that
    is unknown, unsuitable or missing.
    """
    run = run or GuideRun()
    profile, driver = _array_of(run)
    patterns = Patterns(profile, run.guide)
    sequence = open_sequence(source, options or SourceOptions())
    if run.offline and sequence.is_captured:
        raise InvalidArgument("--offline", str(source), "a recorded sequence", "Leave it out.")
    k, size = sequence.intrinsics, (sequence.width, sequence.height)
    evaluate, counts = Guide(k, *size, run.guide), Counts()
    notes = (NOTICE, *sequence.notes, *patterns.notes, *_pose_notes(sequence, run.guide))
    with ExitStack() as stack:
        rows = stack.enter_context(_log(log, patterns.shape)) if log is not None else None

        def show(time_s: float, shown: Shown) -> None:
            if rows is not None:
                rows.add(time_s, shown)
            on_shown(time_s, shown)

        if run.offline:
            _run_offline(sequence, evaluate, patterns, counts, run, show)
        else:
            assert driver is not None
            notes += _run_live(sequence, evaluate, patterns, counts, run, driver, show, on_note)
    counts.pose_jumps = evaluate.pose_jumps
    if rows is not None and rows.left_out:
        notes += (f"{rows.left_out} rows after the first {MAX_ROWS} are not in the log.",)
    figures = {"device": run.device, "profile": profile.name, "has_poses": sequence.poses is not None}
    return {**figures, **counts.summary()}, tuple(dict.fromkeys(notes))


def open_sequence(source: str | Path, options: SourceOptions) -> DepthSequence:
    """Return the depth sequence of a source; raises `SourceError` if it has none."""
    scene = open_capture(source, options) or open_source(source, options)
    if not isinstance(scene, DepthScene):
        found = "a source that is no sequence of depth pictures"
        raise SourceError(str(source), found, "a depth folder, a bag, camera:N, watch:FOLDER or -")
    sequence = scene.sequence
    if sequence.has_wrong_poses:
        sequence.poses = None
        sequence.notes += ("The poses are not used, since they and the depth disagree (--pose-form).",)
    return sequence


def _array_of(run: GuideRun) -> tuple[Device, ArrayDevice | None]:
    """Return the profile of the run, and its driver unless it is offline."""
    profile = None if run.profile is None else device(run.profile)
    text = run.device.strip()
    if not is_array_device(text):
        named = device(text)  # raises with the names of all profiles
        profile = profile or named
        if run.offline:
            return profile, None
        kind = next((kind for kind in array_kinds() if kind.profile == named.name), None)
        if kind is None:
            forces = [kind for kind in array_kinds() if device(str(kind.profile)).shows == "force"]
            drivers = ", ".join(kind.form for kind in forces)
            hint = f"Name the driver, with --profile {named.name}; or add --offline."
            raise InvalidArgument("--device", f"{text}, a profile without a driver of its own", drivers, hint)
        text = kind.name
    driver = array_device(text, profile)
    return driver.profile, None if run.offline else driver


def _pose_notes(sequence: DepthSequence, spec: GuideSpec) -> tuple[str, ...]:
    if sequence.poses is None:
        return ("No camera poses: what is not in the picture is unknown, and nothing is remembered.",)
    if spec.memory_s == 0:
        return ()
    return (f"What left the picture is remembered for {spec.memory_s:g} s, by the camera poses.",)


# -- without a clock ---------------------------------------------------------------------------------------
def _run_offline(
    sequence: DepthSequence,
    evaluate: Guide,
    patterns: Patterns,
    counts: Counts,
    run: GuideRun,
    show: Callable[[float, Shown], None],
) -> None:
    """Evaluate each frame; the delay is the time of the evaluation."""
    _warm(evaluate, sequence)
    limit_s = math.inf if run.seconds is None else run.seconds
    for number in range(sequence.frame_count):
        time_s = number / sequence.rate_hz
        if time_s >= limit_s:
            return
        counts.frames += 1
        depth, start_s = sequence.depth_m(number), time.monotonic()
        pose = None if sequence.poses is None else sequence.poses[number]
        situation = evaluate.update(depth, time_s, pose)
        drives = patterns.drives(situation, time_s)
        counts.add(situation)
        counts.add_delay(time.monotonic() - start_s)
        counts.warning_s += situation.is_blind / sequence.rate_hz
        show(time_s, Shown("blind" if situation.is_blind else "", situation, number, drives))


# -- in real time ------------------------------------------------------------------------------------------
def _run_live(
    sequence: DepthSequence,
    evaluate: Guide,
    patterns: Patterns,
    counts: Counts,
    run: GuideRun,
    driver: ArrayDevice,
    show: Callable[[float, Shown], None],
    on_note: OnNote,
) -> tuple[str, ...]:
    """Guide until the end; returns notes."""
    _warm(evaluate, sequence)
    feed: Feed = CameraFeed(sequence) if isinstance(sequence, CapturedSequence) else ReplayFeed(sequence)
    notes: list[str] = []
    try:
        open_when_ready(driver, duration_s(run.wait, "wait"), on_note=on_note)
        output = Output(driver, patterns, counts, run.guide, show)
        output.start()
        feed.start()
        try:
            _evaluate_frames(feed, evaluate, output, counts, run.seconds, on_note)
        except KeyboardInterrupt:
            notes.append("interrupted: the guidance ends here")
        finally:
            if feed.error is not None:
                output.stop_after(FAREWELL_S)
            output.close()
            feed.close()
        output.raise_error()
    finally:
        driver.close()
    counts.frames, counts.dropped, counts.unreadable = feed.received, feed.dropped, feed.unreadable
    if feed.error is not None:
        if not is_end(feed.error) or not counts.evaluated:
            raise feed.error
        notes.append(str(feed.error))
    return (*notes, *driver.notes)


def _warm(evaluate: Guide, sequence: DepthSequence) -> None:
    """Load or compile the kernels of a memory before the clock starts."""
    first = sequence.depth_m(0)
    pose = None if sequence.poses is None else sequence.poses[0]
    other = Guide(sequence.intrinsics, sequence.width, sequence.height, evaluate.spec)
    for n in range(2):
        other.update(first, float(n), pose)


def _evaluate_frames(
    feed: Feed, evaluate: Guide, output: Output, counts: Counts, seconds: float | None, on_note: OnNote
) -> None:
    """Evaluate the newest frame until the source or the time ends; raises the error of the device."""
    end_s = math.inf if seconds is None else time.monotonic() + seconds
    noted: tuple[str, ...] = ()
    while not feed.is_over and time.monotonic() < end_s:
        frame = feed.take(_MAX_PERIOD_S)
        output.raise_error()
        if output.notes != noted:  # such as a vest that is switched off
            noted = output.notes
            for note in noted:
                on_note(note)
        if frame is None:
            continue
        if frame.depth_m.shape != evaluate.shape:  # of another camera: not seen, which warns
            counts.other_size += 1
            continue
        situation = evaluate.update(frame.depth_m, frame.arrived_s, frame.pose)
        counts.add(situation)
        output.post(situation, frame.number, frame.arrived_s)


class Output:
    """The thread of the drives: shows the latest situation, or a warning, at the rate of the device."""

    def __init__(
        self,
        driver: ArrayDevice,
        patterns: Patterns,
        counts: Counts,
        spec: GuideSpec,
        show: Callable[[float, Shown], None],
    ) -> None:
        self._driver, self._patterns, self._counts, self._spec, self._show = (
            driver, patterns, counts, spec, show,
        )  # fmt: skip
        self._period_s = min(1 / (driver.profile.rate_hz or DEFAULT_RATE_HZ), _MAX_PERIOD_S)
        self._changed = threading.Condition()
        self._posted: tuple[Situation, int, float] | None = None
        self._is_new, self._is_ending, self._is_stopped = False, False, False
        self._error: BaseException | None = None
        self._start_s = self._warned_s = time.monotonic()
        self._warning, self._warned_until_s, self._last_s = "", -math.inf, self._start_s
        self._thread = threading.Thread(target=self._run, name="touchfield-guide-drives", daemon=True)

    def start(self) -> None:
        """Start the thread; it warns until the first situation is posted."""
        self._start_s = self._last_s = time.monotonic()
        self._thread.start()

    def post(self, situation: Situation, frame: int, arrived_s: float) -> None:
        """Show the situation of a frame at once."""
        with self._changed:
            self._posted, self._is_new = (situation, frame, arrived_s), True
            self._changed.notify_all()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the device."""
        return self._driver.notes

    def raise_error(self) -> None:
        """Raise the error of the device, if it has failed."""
        if self._error is not None:
            raise self._error

    def stop_after(self, seconds: float) -> None:
        """Show the warning for a time."""
        with self._changed:
            self._is_ending = True
        time.sleep(seconds)

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._is_new or self._is_stopped, self._period_s)
                    if self._is_stopped:
                        return
                    posted, is_new, self._is_new = self._posted, self._is_new, False
                self._put(posted, is_new)
        except BaseException as error:
            self._error = error

    def _put(self, posted: tuple[Situation, int, float] | None, is_new: bool) -> None:
        """Show a situation or a warning, and count."""
        now_s = time.monotonic()
        reason = self._reason(posted, now_s, is_new)
        was_warning = bool(self._warning)
        if reason:
            self._warning, self._warned_until_s = reason, now_s + WARNING_S
            self._warned_s = self._warned_s if was_warning else now_s
        elif now_s >= self._warned_until_s:
            self._warning = ""
        self._counts.warning_s += (now_s - self._last_s) if was_warning else 0.0
        self._last_s = now_s
        situation, frame, arrived_s = posted or (None, -1, now_s)
        if self._warning or situation is None:
            drives = self._patterns.warning(now_s - self._warned_s)
        else:
            drives = self._patterns.drives(situation, now_s - self._start_s)
        self._driver.put_drives(drives, None, self._period_s)
        if is_new:
            self._counts.add_delay(time.monotonic() - arrived_s)
        if is_new or (self._warning and not was_warning):
            self._show(now_s - self._start_s, Shown(self._warning, situation, frame, drives))

    def _reason(self, posted: tuple[Situation, int, float] | None, now_s: float, is_new: bool) -> str:
        """Return why nothing is known now; "" if the situation holds."""
        if self._is_ending:
            return "ended"
        if posted is None:
            return "no frame"
        situation, _, arrived_s = posted
        if is_new and now_s - arrived_s > MAX_DELAY_S:
            self._counts.late += 1
            return "late"
        if situation.is_blind:
            return "blind"
        if now_s - arrived_s > self._spec.timeout_s:
            self._counts.timeouts += self._warning != "no frame"
            return "no frame"
        return ""


# -- the log -----------------------------------------------------------------------------------------------
def columns(shape: tuple[int, int, int]) -> tuple[str, ...]:
    """Return the columns of a log for an array [panels, rows, columns].

    Seconds, frame (-1 before the first), reason of the warning or empty; for each direction its state
    (unknown, free, near), distance and time to contact; distances of step and drop; height of the camera
    above the ground, empty if it is assumed; and the drives, 0 to 1.
    """
    names = [name.replace(" ", "_") for name in DIRECTIONS]
    drives = [f"drive_{p}_{r}_{c}" for p in range(shape[0]) for r in range(shape[1]) for c in range(shape[2])]
    return (
        "t_s", "frame", "warning", *(f"{n}_state" for n in names), *(f"{n}_m" for n in names),
        *(f"{n}_contact_s" for n in names), "step_m", "drop_m", "camera_height_m", *drives,
    )  # fmt: skip


class _Log:
    """Writes rows to a file, at most `MAX_ROWS`; counts those `left_out`."""

    def __init__(self, file: TextIO, shape: tuple[int, int, int]) -> None:
        self._rows, self._count = csv.writer(file, lineterminator="\n"), 0
        self._rows.writerow(columns(shape))

    def add(self, time_s: float, shown: Shown) -> None:
        """Write a row."""
        self._count += 1
        if self._count <= MAX_ROWS:
            self._rows.writerow(_row(time_s, shown))

    @property
    def left_out(self) -> int:
        """Number of rows that were not written."""
        return max(0, self._count - MAX_ROWS)


@contextmanager
def _log(path: Path, shape: tuple[int, int, int]) -> Iterator[_Log]:
    """Yield a log; the file appears when the block ends."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        yield _Log(file, shape)


def _row(time_s: float, shown: Shown) -> list[object]:
    """Return a row of the log."""
    situation = shown.situation
    if situation is None:
        values: list[object] = [""] * 27
    else:
        numbers = (*situation.distances_m.tolist(), *situation.contact_s.tolist(), *situation.ahead)
        height = f"{situation.ground.height_m:.3f}" if situation.ground.is_seen else ""
        values = [state.name.lower() for state in situation.states]
        values += [f"{v:.3f}" if math.isfinite(v) else "" for v in numbers]
        values.append(height)
    drives = [f"{value:.2f}" for value in shown.drives.reshape(-1).tolist()]
    return [f"{time_s:.4f}", shown.frame, shown.warning, *values, *drives]


class Rows:
    """What was shown, for a picture: the first `MAX_DRAWN` rows."""

    MAX_DRAWN: Final = 1 << 15

    def __init__(self) -> None:
        self._rows: list[tuple[float, Shown]] = []

    def add(self, time_s: float, shown: Shown) -> None:
        """Add a row."""
        if len(self._rows) < self.MAX_DRAWN:
            self._rows.append((time_s, shown))

    def draw(self, path: Path, title: str, spec: GuideSpec) -> None:
        """Draw the rows; raises `SourceError` if there is none."""
        from touchfield.viewer.guidance import GuidanceRows, draw_guidance

        rows = [(time_s, shown, shown.situation) for time_s, shown in self._rows]
        known = [(time_s, shown, s) for time_s, shown, s in rows if s is not None]
        if not known:
            raise SourceError(str(path), "nothing to draw: no frame was evaluated", "frames")
        drawn = GuidanceRows(
            np.array([time_s for time_s, _, _ in known]),
            np.array([s.states for _, _, s in known], np.int64),
            np.array([s.distances_m for _, _, s in known]),
            np.array([s.ahead for _, _, s in known], np.float64),
            np.array([bool(shown.warning) for _, shown, _ in known], np.float64),
        )
        draw_guidance(path, drawn, DIRECTIONS, spec.warn_m, title)
