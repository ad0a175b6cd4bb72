"""What a frame model is: one frame of whole numbers to bytes and back, given what both sides know already.

A model codes support, amplitude and direction of a frame in one pass, in closed loop: whatever it predicts from is
what the decoder holds. There is one for each effort, and one for fields that are quantised already.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField, Grid

__all__ = ["CodedFrame", "DecodedFrame", "FrameModel", "Known", "LearningModel", "Rule", "decode_frame"]


@dataclass(frozen=True)
class Known:
    """What encoder and decoder know before a frame.

    Attributes
    ----------
    grid : Grid
    lattice : Lattice
    previous : FixedField or None
        The decoded frame before, at the same samples.
    guess : FixedField or None
        A field made for this frame: the previous one with its blocks moved, or one synthesised from a surface.
    memory : object, optional
        What the model learnt from the frames of the segment before, as `CodedFrame.memory` and `DecodedFrame.memory`
        gave it, which are equal; nobody changes it. None where it is to begin anew.
    """

    grid: Grid
    lattice: Lattice
    previous: FixedField | None = None
    guess: FixedField | None = None
    memory: Any = None


@dataclass(frozen=True)
class Rule:
    """What error the encoder may make; the decoder does not know it.

    Attributes
    ----------
    k, f0_n : float
        The mask max(F_0, k |F|); of mode "nmse" `k` is 0 and `f0_n` unused.
    sine : float
        Of mode "mask-direction" the sine of the JND; 0 otherwise.
    thrift : float
        Lagrange multiplier: how much error (as a share of the mask, or of the step squared) a bit may cost.
    free : bool
        Mode "nmse": any error is allowed, at its price.
    movable : bool
        Whether the support may move where |F| <= F_0.
    """

    k: float
    f0_n: float
    sine: float = 0.0
    thrift: float = 0.3
    free: bool = False
    movable: bool = True


@dataclass(frozen=True)
class CodedFrame:
    """A frame's bytes and what the decoder will make of them.

    Attributes
    ----------
    payload : bytes
    decoded : FixedField
    bits : (float, float, float)
        Of support, amplitude and direction, by the chances the model gave: their sum is the payload's, about.
    misses : int64 [m]
        Flat slots, ``((brick * 8 + x) * 8 + y) * 8 + z`` into `decoded`, that break the rule (none is expected);
        the caller sends their forces apart.
    """

    payload: bytes
    decoded: FixedField
    bits: tuple[float, float, float]
    misses: NDArray[np.int64]
    memory: Any = None


@dataclass(frozen=True)
class DecodedFrame:
    """A frame as `CodedFrame.decoded` has it, and what the model learnt; None of a model that does not learn."""

    field: FixedField
    memory: Any = None


class FrameModel(Protocol):
    """One way to code a frame."""

    number: int
    """What the file says for it."""

    def encode(self, frame: ForceField, known: Known, rule: Rule) -> CodedFrame:
        """Code one frame."""

    def decode(self, payload: bytes, known: Known) -> FixedField:
        """The inverse; `CorruptFile` or `TruncatedFile` where the bytes are not what `encode` writes."""


@runtime_checkable
class LearningModel(FrameModel, Protocol):
    """One that codes the frames of a segment better by what it learnt from those before."""

    def decode_with_memory(self, payload: bytes, known: Known) -> DecodedFrame:
        """As `decode`."""


def decode_frame(model: FrameModel, payload: bytes, known: Known) -> DecodedFrame:
    """The inverse of `FrameModel.encode`, with what was learnt."""
    if isinstance(model, LearningModel):
        return model.decode_with_memory(payload, known)
    return DecodedFrame(model.decode(payload, known))
