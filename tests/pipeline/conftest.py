"""What the tests of workers share: many small ranges, and the bytes of one process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from touchfield import encode
from touchfield.pipeline import segments


@pytest.fixture(scope="module")
def short_ranges() -> Iterator[None]:
    """Ranges of one segment, so that there are many."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(segments, "SEGMENTS_PER_RANGE", 1)
        yield


@pytest.fixture(scope="module")
def alone(source: Path, short_ranges: None, request: pytest.FixtureRequest) -> bytes:
    """The bytes that one process makes of the module's `source` by its `SPEC`."""
    out = source.with_name("alone.touch")
    encode(source, out, request.module.SPEC)
    return out.read_bytes()
