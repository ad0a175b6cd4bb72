"""Guides a wearer with a depth camera and a vest: command `guide`.

    frames (a thread) -> `Guide` (this thread) -> drives (a thread) -> device, log

It is no mobility aid and replaces no cane. What is not known is never shown as free: without a new frame for
`GuideSpec.timeout_s`, for a blind frame, and for one that reaches the actuators more than `MAX_DELAY_S` after
it arrived, the warning pattern is shown for at least `WARNING_S`. The thread of the drives does not wait for
the others, so that it warns while they hang; if the program hangs or dies, the device switches off by itself.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from touchfield.devices import device
from touchfield.devices.drivers.registry import array_device, array_kinds, is_array_device
from touchfield.errors import InvalidArgument, SourceError, require_ending
from touchfield.guidance.feed import CameraFeed, Feed, ReplayFeed
from touchfield.guidance.guide import Guide
from touchfield.guidance.pattern import Patterns
from touchfield.guidance.spec import GuideSpec
from touchfield.options import duration_s
from touchfield.render.readiness import open_when_ready
from touchfield.sources.depth.capture import CapturedSequence, CaptureEnd, open_capture
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.tasks.guide_log import open_log
from touchfield.tasks.guide_options import GuideRun as GuideRun
from touchfield.tasks.guide_output import MAX_PERIOD_S, Counts, Output, Shown

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.render.array_player import ArrayDevice
    from touchfield.sources.camera import DepthSequence

OnNote = Callable[[str], None]

FAREWELL_S: Final = 1.0
"""How long the warning is shown when a camera ends."""
MAX_WITHOUT_GROUND: Final = 0.1
"""Fraction of the frames from which on a note says that the ground was not found."""
NOTICE: Final = (
    "This is no mobility aid and replaces no cane: see docs/how-to/guide.md for what it does not see."
)


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
    if log is not None:
        require_ending(log, "LOG.csv")
    profile, driver = _array_of(run)
    patterns = Patterns(profile, run.guide)
    sequence = open_sequence(source, options or SourceOptions())
    if run.offline and sequence.is_captured:
        raise InvalidArgument("--offline", str(source), "a recorded sequence", "Leave it out.")
    k, size = sequence.intrinsics, (sequence.width, sequence.height)
    evaluate, counts = Guide(k, *size, run.guide), Counts()
    notes = (NOTICE, *sequence.notes, *patterns.notes, *_pose_notes(sequence, run.guide))
    with ExitStack() as stack:
        rows = stack.enter_context(open_log(log, patterns.shape)) if log is not None else None

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
    if rows is not None:
        notes += rows.notes
    notes += _ground_notes(counts)
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


def _ground_notes(counts: Counts) -> tuple[str, ...]:
    """Return a note if steps were looked for in few frames."""
    if counts.without_ground <= MAX_WITHOUT_GROUND * counts.evaluated:
        return ()
    return (
        f"No ground was found in {counts.without_ground} of {counts.evaluated} frames, so no steps and drops "
        "are shown in them: --pitch-deg and --camera-height-m state how the camera is worn.",
    )


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
        if not isinstance(feed.error, CaptureEnd) or not counts.evaluated:
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
        frame = feed.take(MAX_PERIOD_S)
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
