"""A live server in a process of its own, for tests that kill it: ``python fleet_server.py PORT [TOKEN]``.

It prints its address, and sends the segments of `live_makers` in time until it is ended.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from itertools import count
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from live_makers import segment, sender_of
from touchfield.network.access import Access
from touchfield.network.live_server import LiveServer

PERIOD_S = 0.1


def run(port: int, token: str | None) -> None:
    """Serve until the process is ended."""
    sender, bodies = sender_of(0)[0], [segment(5 * i) for i in range(12)]
    with LiveServer(sender, Access(port=port, token=token)) as server:
        print(server.address, flush=True)
        start_s = time.monotonic()
        for i in count():
            server.add(replace(bodies[i % 12], first_frame=5 * i))
            time.sleep(max(0.0, start_s + PERIOD_S * (i + 1) - time.monotonic()))


if __name__ == "__main__":
    run(int(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else None)
