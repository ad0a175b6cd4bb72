"""What `touchfield doctor` finds: one line each, with how to mend it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Check"]


@dataclass(frozen=True)
class Check:
    """One thing that a device or a format needs.

    Attributes
    ----------
    what : str
        Such as "library websockets", "service on port 10001".
    is_there : bool
    found : str
        Such as "16.0", "connection refused".
    mend : str
        One line on how to mend it; "" where there is nothing to mend.
    """

    what: str
    is_there: bool
    found: str
    mend: str = ""
