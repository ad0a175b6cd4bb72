"""The last resort where a servo is gone without having brought the force to zero: zero through a fresh connection.

The opener is called once more in a process of its own, which gets no longer than `LONGEST_S` and is then ended.
"""

from __future__ import annotations

import multiprocessing
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from touchfield.render.servo import Opener

__all__ = ["is_waiting", "zero_afresh"]

LONGEST_S: Final = 5.0
"""In which a new interpreter starts, the device is opened, and zero is written."""


def _zero(opener: Opener, pipe: Connection) -> None:
    try:
        device = opener()
        try:
            device.open()
            if not device.is_driven:
                device.put_force_n(0.0, 0.0, 0.0)
        finally:
            device.close()
        pipe.send("")
    except BaseException as error:
        pipe.send(f"{type(error).__name__}: {error}")


def zero_afresh(opener: Opener) -> str:
    """Open the device anew, write a force of zero and close it; a note that tells how it went."""
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_zero, args=(opener, theirs), name="touchfield-zero", daemon=True)
    try:
        process.start()
        theirs.close()
        said = mine.recv() if mine.poll(LONGEST_S) else f"no answer within {LONGEST_S:g} s"
    except (EOFError, OSError) as error:
        said = f"{type(error).__name__}"
    finally:
        process.join(0.5)
        if process.is_alive():
            process.kill()
            process.join()
        mine.close()
        process.close()
    if said:
        return f"A force of zero was tried through a fresh connection, which failed ({said}): switch the device off"
    return "A force of zero was written through a fresh connection to the device"


def is_waiting(pid: int) -> bool:
    """Whether no thread of a process runs or could run; True where the system does not tell.

    A process that could run has only not got the processor, as on a machine with too much to do.
    """
    try:
        for one in Path(f"/proc/{pid}/task").iterdir():
            if (one / "stat").read_text().rpartition(")")[2].split()[0] == "R":
                return False
    except (OSError, IndexError):
        pass
    return True
