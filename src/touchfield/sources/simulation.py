"""A rigid-body simulation with MuJoCo: the pose of every body at the frames of a scene (paper section 5.1, Scene 1).

Frame i is the state at the time i / rate, so that frame 0 is the state it begins from and 2 s at 1 kHz are 2000
frames. The same model gives the same poses, bit for bit, on one machine.
"""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final

import numpy as np

from touchfield.errors import InvalidArgument, SourceError, import_extra
from touchfield.medium.pose_track import PoseTrack

FRAME_RATE_HZ: Final = 1000.0  # frames a second where none are asked for: the rate of haptic rendering
START: Final = "touchfield"  # name of the keyframe from which a simulation begins, where the model has it
_MAX_POSES: Final = 1 << 22  # bodies times frames; 28 doubles of 8 bytes and their copies are kept for each
_MAX_STEPS: Final = 20_000_000  # steps times bodies: up to half a minute of one core
_STEPS_S: Final = (1e-9, 1e9)

_one_at_a_time = threading.Lock()


def load_mujoco() -> Any:
    """The module, imported when it is first needed; `MissingExtra` if it is not installed."""
    return import_extra("mujoco", "a simulation of rigid bodies", "mujoco", "physics")


def mujoco_faults(mujoco: Any) -> tuple[type[Exception], ...]:
    """Errors of MuJoCo for a model at fault."""
    return (ValueError, MemoryError, mujoco.FatalError, mujoco.UnexpectedError)


@contextmanager
def warnings_heard(mujoco: Any) -> Iterator[list[str]]:
    """The warnings of MuJoCo, which otherwise go to the screen and into a file in the working folder."""
    heard: list[str] = []
    with _one_at_a_time:  # the handler is one for the whole process
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda said: heard.append(str(said)))
        try:
            with warnings.catch_warnings(record=True) as told:  # the compiler of models warns as Python does
                warnings.simplefilter("always")
                yield heard
        finally:
            mujoco.set_mju_user_warning(before)
            heard += [str(one.message) for one in told]


def compiled(make: Callable[[], Any], where: str, found: str, expected: str) -> tuple[Any, tuple[str, ...]]:
    """Result of `make`, and what MuJoCo warned of; `SourceError` in these words where it refuses."""
    mujoco = load_mujoco()
    try:
        with warnings_heard(mujoco) as heard:
            made = make()
    except mujoco_faults(mujoco) as error:
        raise SourceError(where, f"{found} ({error})", expected) from error
    return made, tuple(f"MuJoCo warns: {' '.join(said.split())[:200]}" for said in heard)


def frames_of(where: str, seconds: float, rate_hz: float, body_count: int = 1) -> int:
    """Frames of a duration, at least one; `InvalidArgument` for more poses of so many bodies than are kept."""
    frames = seconds * rate_hz
    if not frames * body_count <= _MAX_POSES:
        found = f"{seconds:g} s at {rate_hz:g} Hz for {body_count} bodies"
        raise InvalidArgument(where, found, f"at most {_MAX_POSES} poses", "Ask for fewer seconds or a lower rate.")
    return max(round(frames), 1)


def simulated(
    model: Any,
    body_ids: Sequence[int],
    frame_count: int,
    rate_hz: float,
    where: str,
    posed: Mapping[int, PoseTrack] | None = None,
) -> tuple[list[PoseTrack], tuple[str, ...]]:
    """Step a model and record its bodies.

    The model's time step must divide the time between frames; where it does not, the nearest that does is set, and a
    note says so. A keyframe of the name `START` is the state it begins from. Controls are 0. `where` is what to call
    the model in messages; `posed` are the poses, and so velocities, that bodies with a free joint are given.

    Gives a track for each of `body_ids`, scene from body frame, and notes.

    Raises `SourceError` if the simulation diverges, MuJoCo cannot go on, or the time step is none; `InvalidArgument`
    if it would take more than 20 million steps of a body.
    """
    mujoco = load_mujoco()
    if not _STEPS_S[0] <= model.opt.timestep <= _STEPS_S[1]:
        found, (least, most) = f"{model.opt.timestep:g} s", _STEPS_S
        raise SourceError(f"{where}: timestep", found, f"{least:g} to {most:g} s")
    steps, notes = _steps_a_frame(model, rate_hz)
    if steps * frame_count * len(body_ids) > _MAX_STEPS:
        found, mend = f"{frame_count} frames of {steps} steps of {len(body_ids)} bodies", "Make the step longer."
        raise InvalidArgument(where, found, f"at most {_MAX_STEPS} steps of a body", f"Ask for less. {mend}")
    ids = np.asarray(body_ids, np.intp)
    positions, quaternions = np.empty((frame_count, len(ids), 3)), np.empty((frame_count, len(ids), 4))
    driven = [_Driven(model, body, track, rate_hz) for body, track in (posed or {}).items()]
    try:
        with warnings_heard(mujoco) as heard:
            data = _begun(mujoco, model)
            for frame in range(frame_count):
                for body in driven:
                    body.place(data, frame)
                mujoco.mj_kinematics(model, data)
                positions[frame], quaternions[frame] = data.xpos[ids], data.xquat[ids]
                if frame + 1 < frame_count:
                    mujoco.mj_step(model, data, steps)
                if heard:
                    notes += _judged(mujoco, data, heard, f"{where}, {(frame + 1) / rate_hz:g} s")
    except mujoco_faults(mujoco) as error:
        raise SourceError(where, f"a simulation that stops: {error}", "a model that MuJoCo can step") from error
    return [PoseTrack(quaternions[:, k], positions[:, k]) for k in range(len(ids))], notes


class _Driven:
    """A body whose free joint is set, frame by frame, to the poses and velocities of a track."""

    def __init__(self, model: Any, body: int, track: PoseTrack, rate_hz: float) -> None:
        joint = int(model.body_jntadr[body])
        self._place, self._motion = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        self._poses = np.concatenate([track.positions_m, track.quaternions], axis=1)
        ahead = np.diff(track.positions_m, axis=0, append=track.positions_m[-1:]) * rate_hz
        _, spin = track.velocities(rate_hz)
        own_spin = np.einsum("fji,fj->fi", track.rotations(), spin)  # MuJoCo has it in the body's frame
        self._velocities = np.concatenate([ahead, own_spin], axis=1)

    def place(self, data: Any, frame: int) -> None:
        data.qpos[self._place : self._place + 7] = self._poses[frame]
        data.qvel[self._motion : self._motion + 6] = self._velocities[frame]


def _begun(mujoco: Any, model: Any) -> Any:
    data = mujoco.MjData(model)
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, START)
    if key >= 0:
        mujoco.mj_resetDataKeyframe(model, data, key)
    return data


def _steps_a_frame(model: Any, rate_hz: float) -> tuple[int, tuple[str, ...]]:
    """Steps between two frames; sets the model's time step to what divides the time between them."""
    period, asked = 1.0 / rate_hz, float(model.opt.timestep)
    below = max(math.floor(period / asked * (1 + 1e-9)), 1)
    steps = min((below, below + 1), key=lambda n: (abs(period / n - asked), n))
    model.opt.timestep = period / steps
    if abs(period / steps - asked) <= 1e-9 * asked:
        return steps, ()
    wording = f"A time step of {asked:g} s does not divide a frame of {period:g} s; it is {period / steps:g} s."
    return steps, (wording,)


def _judged(mujoco: Any, data: Any, heard: list[str], where: str) -> tuple[str, ...]:
    """Warnings as notes; `SourceError` where they say that the state is no longer a state."""
    said = " ".join(" ".join(heard).split())[:200]
    heard.clear()
    kinds = mujoco.mjtWarning
    for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC):
        if data.warning[int(kind)].number:
            expected = "a stable simulation"
            raise SourceError(where, f"that it diverges ({said})", expected, "Make the time step shorter.")
    return (f"MuJoCo warns: {said}",)
