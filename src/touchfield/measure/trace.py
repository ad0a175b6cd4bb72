"""A recorded interaction, as the measures take it (`touchfield.medium.trace`)."""

from touchfield.medium.trace import HAPTIC_RATE_HZ, MAX_SAMPLES, Trace, read_trace

__all__ = ["HAPTIC_RATE_HZ", "MAX_SAMPLES", "Trace", "read_trace"]
