"""One block laid out for a medium, a device and a spec: what the player and a run without a process share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from touchfield.errors import InvalidArgument
from touchfield.render.block import words as W
from touchfield.render.block.memory import DEFAULT_BYTES, SLOTS, Layout, Memory
from touchfield.render.feeder import FIRST_GENERATION, Feeder, arena_words
from touchfield.render.frame_source import FrameSource
from touchfield.render.material import material_words, stored_materials, write_materials
from touchfield.render.spec import RenderSpec, write_parameters
from touchfield.render.tool import tool_words, write_tool
from touchfield.render.walls import Stability, Wall, stability_of

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.medium import HapticMedium, HapticScene

_FASTEST: Final = 100.0
_AHEAD_S: Final = 4.0
"""The directory has room for so much of a medium; frames of a high rate are many."""
_MOST_SLOTS: Final = 1 << 14
_RAMP_SPARE_S: Final = 1.0
_LONGEST_RAMP_S: Final = 10.0


@dataclass(frozen=True)
class Orders:
    """Wishes of the player to the servo at one time: a generation, which begins at a media time, and its mode."""

    generation: int
    start_s: float
    speed: float = 1.0
    mode: int = W.IDLE
    is_stopping: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.speed) and 0 < self.speed <= _FASTEST):
            raise InvalidArgument("speed", repr(self.speed), f"above 0, up to {_FASTEST:g}")

    def give(self, memory: Memory) -> None:
        """Write them into the block."""
        from touchfield.render.kernels.cycle import give_order

        order = self.generation, self.start_s, float(self.speed), self.mode, int(self.is_stopping)
        give_order(memory.i8, memory.f8, *order)


def ramp_limit_s(peak_n: float, slew_n_per_s: float, ramp_s: float) -> float:
    """The longest that a force may take to go to zero, with time to spare, seconds."""
    return min(_RAMP_SPARE_S + ramp_s + 2 * peak_n / slew_n_per_s, _LONGEST_RAMP_S)


class Session:
    """Sizes, parameters, first order and feeder of one session on a type 1 device; arguments as of `Player`."""

    def __init__(
        self,
        medium: HapticMedium | HapticScene,
        device: Device,
        spec: RenderSpec,
        memory_bytes: int = DEFAULT_BYTES,
        loop: bool = False,
        speed: float = 1.0,
        start_s: float = 0.0,
    ) -> None:
        self.source = FrameSource(medium, spec.blend, spec.deformation)
        self._device, self._spec, self.is_loop = device, spec, loop
        self.orders = Orders(FIRST_GENERATION, self.checked_s(start_s), speed)
        ahead = min(_AHEAD_S * self.source.rate_hz * max(speed, 1.0), float(_MOST_SLOTS))
        slots = max(1 << math.ceil(ahead - 1).bit_length(), SLOTS)
        self._materials = stored_materials(medium.provenance) if spec.materials is None else spec.materials
        self._objects = tuple(one.name for one in getattr(medium, "objects", ()))
        arena, tool, material = arena_words(self.source, memory_bytes), tool_words(spec.tool), self._materials
        self.layout = Layout(
            arena, slots, tool_words=tool, material_words=material_words(material), yield_words=self._yield_words
        )
        self._notes: tuple[str, ...] = ()
        self._wall = self._wall_of_spec()
        self._stability: Stability | None = None
        self._stiffest_n_per_m = -math.inf

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user; of the damping and coupling that were chosen, those of the frames so far."""
        return self._notes if self._stability is None else (*self._notes, self._stability.note)

    def _wall_of_spec(self) -> Wall | None:
        """The wall of the proxy; None where the field is rendered as it is."""
        spec = self._spec
        if (
            spec.render == "field"
            or spec.deformation is not None
            or (spec.render == "auto" and (spec.coupling_n_per_m or spec.tool is not None))
        ):
            return None
        wall = self.source.wall()
        if wall is None and spec.render == "proxy":
            raise InvalidArgument("render", "'proxy' of a field that is no wall's", "field, or auto")
        if wall is None or spec.wall_n_per_m is None:
            return wall
        return replace(wall, stiffness_n_per_m=spec.wall_n_per_m)

    @property
    def seconds(self) -> float:
        """Of the medium, once; of one frame, for ever."""
        return math.inf if self.source.frame_count == 1 else self.source.frame_count / self.source.rate_hz

    @property
    def _yield_words(self) -> int:
        """Words of the displacements by which the medium yields."""
        bent = self._spec.deformation
        return bent.displacement_m[0].size if bent is not None and bent.compliance_m_per_n else 0

    def checked_s(self, time_s: float) -> float:
        """A media time to go to; past the end it begins anew where the medium is looped, and else is the end."""
        if not (math.isfinite(time_s) and time_s >= 0):
            raise InvalidArgument("time", repr(time_s), "seconds from the beginning, 0 or more")
        if self.source.frame_count == 1:
            return 0.0
        return math.fmod(time_s, self.seconds) if self.is_loop else min(time_s, self.seconds)

    def frame_at(self, time_s: float) -> int:
        """The unrolled frame at a media time."""
        from touchfield.render.kernels.cycle import unrolled_frame

        return 0 if self.source.frame_count == 1 else int(unrolled_frame(time_s, self.source.rate_hz))

    def set_up(self, memory: Memory, mode: int = W.IDLE) -> None:
        """Write all that the servo needs before its first tick."""
        source, spec = self.source, self._spec
        self.layout.write(memory, source.frame_count, source.rate_hz, self.is_loop, spec.rate_hz)
        self._notes = write_parameters(
            memory, spec, self._device, source.friction, source.damping_n_s_per_m, source.axes
        )
        write_tool(memory, self.layout.tool, spec.tool)
        own_friction = spec.friction is None
        self._notes += write_materials(memory, self.layout.material, self._materials, self._objects, own_friction)
        f8 = memory.f8
        if self._yield_words:
            f8[self.layout.yields : self.layout.yields + self._yield_words] = 0.0
            source.yield_at(self.layout.yields)
        if self._wall is not None:
            f8[W.WALL], f8[W.WALL_LEVEL] = self._wall.stiffness_n_per_m, self._wall.level_n
            f8[W.WALL_SPACING : W.WALL_SPACING + 3] = self._wall.spacing_m
            self._notes = (*self._notes, f"a proxy holds the hand at walls of {self._wall.stiffness_n_per_m:.0f} N/m")
        limits = ((W.PEAK, W.SLEW), (W.TORQUE_PEAK, W.TORQUE_SLEW))
        ramps_s = [ramp_limit_s(float(f8[a]), float(f8[b]), spec.ramp_s) for a, b in limits if f8[a] > 0]
        memory.i8[W.RAMP_LIMIT_NS] = round(1e9 * max(ramps_s))
        f8[W.MEDIA_S] = self.orders.start_s
        self._stiffest_n_per_m, self._stability = -math.inf, None
        self._adapt(memory, source.stiffest_n_per_m if self._wall is None else self._wall.stiffness_n_per_m)
        self.order(memory, mode=mode)

    def _adapt(self, memory: Memory, stiffness_n_per_m: float) -> None:
        """Choose damping and coupling anew for a frame that is stiffer than those before; the ticks follow slowly.

        A proxy's walls have one stiffness, whatever the slopes of the field.
        """
        if stiffness_n_per_m <= self._stiffest_n_per_m or (self._wall is not None and self._stability is not None):
            return
        self._stiffest_n_per_m = stiffness_n_per_m
        chosen = stability_of(self._device, self._spec, self.source.damping_n_s_per_m, stiffness_n_per_m)
        memory.f8[W.BRAKE] = chosen.brake_n_s_per_m
        memory.f8[W.COUPLING] = chosen.coupling_n_per_m
        if self._spec.damping_n_s_per_m is None or self._spec.coupling_n_per_m is None:
            self._stability = chosen

    def order(self, memory: Memory, *, seek_s: float | None = None, **changes: Any) -> Orders:
        """Change what is wanted (fields of `Orders`), the rest as it was; a seek is a new generation."""
        if seek_s is not None:
            changes |= {"generation": self.orders.generation + 1, "start_s": self.checked_s(seek_s)}
        wanted = replace(self.orders, **changes)
        wanted.give(memory)
        self.orders = wanted
        return wanted

    def feeder(self, memory: Memory, reserve: Callable[[int], None] | None = None, is_timed: bool = True) -> Feeder:
        """The feeder of this block, not yet begun."""
        first, tell = self.frame_at(self.orders.start_s), partial(self._adapt, memory)
        return Feeder(self.source, memory, self.layout, first, self.is_loop, reserve, is_timed, tell_stiffness=tell)


def is_over(memory: Memory) -> bool:
    """True if the medium is over, or its feed has failed and all that was fed is shown, and the force is zero."""
    i8 = memory.i8
    if i8[W.SEQUENCE_SEEN] != i8[W.SEQUENCE]:  # read first, and written last: the rest is of this order
        return False
    feed = int(i8[W.FEED])
    is_starved = feed in (W.STALLED, W.WAITING) or i8[W.MODE_NOW] != W.PLAYING
    has_come = feed == W.ENDED or (i8[W.FEED_FAILED] and is_starved)
    return bool(has_come and i8[W.RESTING])
