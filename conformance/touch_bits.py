"""The bits of coder `touch` for the second decoder: a range decoder, adaptive chances and their mixing.

All numbers are Python's; none needs more than 62 bits.
"""

from __future__ import annotations

from bisect import bisect_left

__all__ = ["Bits"]

ONE, LEAST, FLOOR, DOMAIN, LIMIT, RATE = 1 << 48, 1 << 32, 4, 3072, 255, 14


def tables() -> tuple[list[int], list[int], list[int]]:
    """The logistic function from -12 to 12 in 1/256, its inverse at the middle of each 1/4096, and learning rates."""
    one = 1 << 96
    step = term = one
    for k in range(1, 20):
        term //= 256 * k
        step += term
    power, half = one, []
    for _ in range(DOMAIN):
        half.append((65536 * power + (one + power) // 2) // (one + power))
        power = power * step >> 96
    below = [65536 - p for p in reversed(half[1:])]
    squash = [below[0], *below, *half]
    stretch = [bisect_left(squash, 16 * n + 8) - DOMAIN for n in range(4096)]
    return [limited(p) for p in squash], stretch, [(1 << 20) // (2 * n + 3) for n in range(1024)]


def limited(p: int) -> int:
    """A chance that leaves room for both bits."""
    return max(FLOOR, min(p, 65536 - FLOOR))


SQUASH, STRETCH, RATES = tables()


class Bits:
    """Bits of a code, behind whose end there are zeros; chances and weights are made when they are first asked for.

    Parameters
    ----------
    data : bytes
    inputs : int
        Chances that are mixed in most places, which sets the first weights.
    """

    def __init__(self, data: bytes, inputs: int) -> None:
        self.data, self.place, self.range = data, 6, ONE
        self.x = int.from_bytes(data[:6].ljust(6, b"\0"), "big")
        self.first_weight = 78643 // inputs
        self.chances: dict[int, tuple[int, int]] = {}
        self.weights: dict[int, list[int]] = {}

    def narrow(self, p: int) -> int:
        """A bit that is 1 with chance p / 65536."""
        bound = (self.range >> 16) * p
        bit = int(self.x < bound)
        self.x, self.range = (self.x, bound) if bit else (self.x - bound, self.range - bound)
        if self.range < LEAST:
            word = self.data[self.place : self.place + 2].ljust(2, b"\0")
            self.x, self.range = self.x << 16 | int.from_bytes(word, "big"), self.range << 16
            self.place += 2
        return bit

    def seen(self, context: int) -> tuple[int, int]:
        """The chance of a context, of 2^22, and how often it was learnt."""
        return self.chances.get(context, (1 << 21, 0))

    def learn(self, context: int, bit: int) -> None:
        """Move a chance towards a bit."""
        chance, count = self.seen(context)
        chance += ((-bit & (1 << 22) - 1) - chance) * RATES[count] >> 19
        self.chances[context] = chance, count + (count < LIMIT)

    def code(self, context: int) -> int:
        """A bit by one context."""
        bit = self.narrow(limited(self.seen(context)[0] >> 6))
        self.learn(context, bit)
        return bit

    def mix(self, contexts: list[int], chosen: int) -> int:
        """A bit by several contexts, mixed by a set of weights."""
        weights = self.weights.setdefault(chosen, [self.first_weight] * 8)
        logits = [STRETCH[self.seen(c)[0] >> 10] for c in contexts]
        total = sum(x * w for x, w in zip(logits, weights)) >> 16
        p = SQUASH[max(-DOMAIN, min(total, DOMAIN - 1)) + DOMAIN]
        bit = self.narrow(p)
        error = (bit << 16) - p
        for n, (context, logit) in enumerate(zip(contexts, logits)):
            weights[n] += logit * error + (1 << RATE - 1) >> RATE
            self.learn(context, bit)
        return bit

    def even(self, count: int) -> int:
        """A number of even bits, the highest first."""
        out = 0
        for _ in range(count):
            out = out << 1 | self.narrow(32768)
        return out

    def number(self, context: int, most: int) -> int:
        """A number: up to `most` in unary, the rest in Elias' gamma code."""
        n = 0
        while n < most:
            if not self.code(context + n):
                return n
            n += 1
        digits = 0
        while digits < 30 and self.even(1):
            digits += 1
        return most - 1 + (1 << digits | self.even(digits))
