"""A server of S3 on loopback with an empty bucket, which records its requests."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.request import Request, urlopen


class Requests(logging.Handler):
    """The requests that the server has answered, as lines "GET /bucket/key 206"."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        plain = re.sub(r"\x1b\[\d+m", "", record.getMessage())  # without colours
        if found := re.search(r'"(\S+) (\S+) \S+" (\d+)', plain):
            self.lines.append(" ".join(found.groups()))

    def of(self, method: str, key: str, status: int) -> int:
        """The number of requests of a method whose key contains a text."""
        return sum(
            line.startswith(f"{method} ") and key in line and line.endswith(f" {status}")
            for line in self.lines
        )


@contextmanager
def bucket_server() -> Iterator[tuple[Requests, dict[str, str]]]:
    """Serve the bucket "bucket"; the requests, and the environment by which clients find the server."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    address = "http://{}:{}".format(*server.get_host_and_port())
    environment = {
        "AWS_ENDPOINT_URL": address, "AWS_ALLOW_HTTP": "true", "AWS_REGION": "us-east-1",
        "AWS_DEFAULT_REGION": "us-east-1", "AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret",
    }  # fmt: skip
    urlopen(Request(f"{address}/moto-api/reset", method="POST")).close()  # servers share their buckets
    urlopen(Request(f"{address}/bucket", method="PUT")).close()
    requests, logger = Requests(), logging.getLogger("werkzeug")
    level = logger.level
    logger.addHandler(requests)
    logger.setLevel(logging.INFO)
    try:
        yield requests, environment
    finally:
        logger.removeHandler(requests)
        logger.setLevel(level)
        server.stop()
