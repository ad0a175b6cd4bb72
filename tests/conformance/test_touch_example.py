"""The example of docs/format/touch.md: both decoders find its values in its bytes, bit by bit.
``python tests/conformance/test_touch_example.py`` prints it again.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from second import CONFORMANCE, decoder, reading

from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid

part: Any = importlib.import_module("decode_touch")
frames: Any = importlib.import_module("touch_frame")
GRID = Grid((1, 2, 3), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))
CHAPTER = CONFORMANCE.parent / "docs" / "format" / "touch.md"


def encoded() -> tuple[bytes, bytes]:
    """Parameters and body of a frame of a small wall."""
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[..., 1:, 2] = (-0.5, -1.0)
    forces[:, 1, 2] = (0.25, 0, -0.75)
    encoder = TouchEncoder(GRID, TouchSpec(guess="off"))
    return encoder.parameters, encoder.encode_segment([ForceField.from_dense(GRID, forces)]).body


class DecodingTrace:
    """The steps of the reference decoder: probabilities, bits, and forces in units."""

    def __init__(self, monkeypatch: Any) -> None:
        self.lines = ["list"]
        narrow, brick, voxel, support = (
            frames.Bits.narrow, frames.Frame.brick, frames.Frame.store, frames.Frame.support,
        )  # fmt: skip

        def bit(bits: Any, p: int) -> int:
            out: int = narrow(bits, p)
            self.lines[-1] += f" {p}:{out}"
            return out

        def start_brick(frame: Any, *context: Any) -> None:
            self.lines.append("blocks")
            brick(frame, *context)

        def start_voxel(frame: Any, v: Any) -> int:
            self.lines.append("{},{},{}".format(*v.at))
            out: int = support(frame, v)
            return out

        def end_voxel(frame: Any, at: Any, vector: Any, *sizes: int) -> None:
            self.lines[-1] += " = {},{},{}".format(*vector)
            voxel(frame, at, vector, *sizes)

        for owner, name, replacement in (
            (frames.Bits, "narrow", bit), (frames.Frame, "brick", start_brick),
            (frames.Frame, "support", start_voxel), (frames.Frame, "store", end_voxel),
        ):  # fmt: skip
            monkeypatch.setattr(owner, name, replacement)


def example(parameters: bytes, body: bytes, monkeypatch: Any) -> list[str]:
    """The lines of the example."""
    c = reading.Cursor(body)
    out = [f"{parameters.hex():38}parameters"]

    def line(start: int, meaning: str) -> None:
        out.append(f"{body[start : c.at].hex():38}{meaning}")

    at, _ = c.at, c.number("B")
    line(at, "flags")
    at, unit_n = c.at, c.number("f")
    line(at, f"unit {unit_n:.5g} N")
    at, steps = c.at, [c.varint() for _ in range(4)]
    line(at, "floor {}, rate {}, cross floor {}, cross rate {}".format(*steps))
    at, max_error = c.at, (c.number("H"), c.varint(), c.varint(), c.varint(), c.varint())
    line(at, f"largest error {max_error[0]}/65535, frame {max_error[1]}, voxel {max_error[2:]}")
    at, (kind, _, _) = c.at, c.numbers("3B")
    line(at, f"frame flags {kind}, bit fractions")
    at, size = c.at, c.varint()
    line(at, f"payload of {size} bytes")
    at, scan_order, slope = c.at, c.number("B"), [c.varint() for _ in range(3)]
    line(at, "scan order {}, slope {}, {}, {}".format(scan_order, *slope))
    at, _ = c.at, c.take(len(body) - c.at)
    line(at, "code")
    with monkeypatch.context() as inner:
        trace = DecodingTrace(inner)
        list(part.decode_segment(body, parameters, GRID.shape, 1))
    return out + trace.lines


def test_the_example(monkeypatch: Any) -> None:
    lines = CHAPTER.read_text().split("## Example")[1].split("```text\n")[1].split("\n```")[0].splitlines()
    parameters, body = encoded()
    assert example(parameters, body, monkeypatch) == lines
    (decoded,) = TouchDecoder(GRID, parameters).frames(body, 1)
    (reference,) = part.decode_segment(body, parameters, GRID.shape, 1)
    np.testing.assert_array_equal(decoder.laid_out(reference, GRID.shape), decoded.to_dense())
    deepest = CHAPTER.read_text().split("The deepest force is (")[1].split(")")[0]
    np.testing.assert_array_equal(decoded.to_dense()[0, 0, 2], np.array(deepest.split(","), np.float32))


if __name__ == "__main__":
    import pytest

    stream = encoded()
    print("\n".join(example(*stream, pytest.MonkeyPatch())))
    print([f.to_dense().tolist() for f in TouchDecoder(GRID, stream[0]).frames(stream[1], 1)])
