"""Compiled inner loop of the RVL decoder (`touchfield.sources.depth.recorders.ros_messages.decode_rvl`)."""

from __future__ import annotations

from touchfield.compute.jit import inner, kernel


@inner
def _number(nibbles, at):
    """Return the number at a nibble and the next nibble; -1 if the nibbles end, or it is too long."""
    value = 0
    for n in range(9):
        if at >= len(nibbles):
            return -1, at
        nibble = nibbles[at]
        at += 1
        value |= (nibble & 7) << (3 * n)
        if nibble < 8:
            return value, at
    return -1, at


@kernel
def decode_nibbles(nibbles, samples):
    """Fill `samples`, which are zero; return their number, or 0 if the nibbles end early or are invalid."""
    at, done, previous = 0, 0, 0
    while done < len(samples):
        zeros, at = _number(nibbles, at)
        others, at = _number(nibbles, at)
        if zeros < 0 or others < 0 or zeros + others > len(samples) - done or zeros + others == 0:
            return 0
        done += zeros
        for _ in range(others):
            code, at = _number(nibbles, at)
            if code < 0:
                return 0
            previous += (code >> 1) ^ -(code & 1)
            if not 0 <= previous <= 65535:
                return 0
            samples[done] = previous
            done += 1
    return done
