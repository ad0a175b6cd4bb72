"""What the player and the servo both see: one block of memory, in words of eight bytes.

The block begins with fixed places (below), the same for every stream; behind them lie the directory of frames, the
log and the *arena* in which frames are written. Compiled code gets the block as four views of the same bytes, so that
it can be called from Python and from a vendor's driver, which knows nothing but an address.

==========  =====  =======================================================================================
CONTROL     i8     sizes and places of the rest, orders of the player (clock, seek, stop), signs of life
PARAMETERS  f8     what was asked of the renderer: `spec.RenderSpec`, the mapping, limits
STATE       f8     what one tick leaves for the next: last force, filters, energy, heat
WRENCH      f8     of a tool and a hand that turns: how it is turned, torque and its limits (`wrench_places`)
COUNTS      i8     ticks, late ticks, underruns, and the histograms
==========  =====  =======================================================================================

Each room of the renderer names its own places: orders and signs in `kernels.cycle`, parameters and state of the
effects in `places`, counts in `statistics`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CONTROL", "COUNTS", "FREE", "PARAMETERS", "STATE", "WORD", "WRENCH", "Memory"]

WORD: Final = 8

CONTROL: Final = 0
PARAMETERS: Final = 128
STATE: Final = 256
WRENCH: Final = 384
COUNTS: Final = 512
FREE: Final = 8192
"""The first word that no fixed place takes."""


@dataclass(frozen=True)
class Memory:
    """One block as four views of the same bytes, in the order in which every kernel takes them.

    Attributes
    ----------
    i8 : int64 [words]
    u8 : uint64 [words]
    f8 : float64 [words]
    f4 : float32 [2 * words]
    """

    i8: NDArray[np.int64]
    u8: NDArray[np.uint64]
    f8: NDArray[np.float64]
    f4: NDArray[np.float32]

    @classmethod
    def of(cls, buffer: Any) -> Memory:
        """The views of a writeable buffer whose length is a multiple of eight bytes."""
        if len(buffer) % WORD:
            raise InvalidArgument("buffer", f"{len(buffer)} bytes", "a multiple of 8")
        octets = np.frombuffer(buffer, np.uint8)
        return cls(octets.view(np.int64), octets.view(np.uint64), octets.view(np.float64), octets.view(np.float32))

    @classmethod
    def empty(cls, words: int) -> Memory:
        """A block of zeros within this process."""
        return cls.of(bytearray(WORD * words))

    @property
    def views(self) -> tuple[Any, Any, Any, Any]:
        """i8, u8, f8, f4: what the kernels take."""
        return self.i8, self.u8, self.f8, self.f4

    @property
    def words(self) -> int:
        """How many there are."""
        return len(self.i8)
