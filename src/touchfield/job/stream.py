"""file -> segments -> decoder -> medium: the decoding half of figure 4."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

from touchfield.codec.paper import PaperDecoder
from touchfield.codec.paper_format import FrameCost
from touchfield.container import TouchReader
from touchfield.errors import InvalidArgument, UnsupportedVersion
from touchfield.job.spec import Report, silent
from touchfield.measure.rate import BitAccount, compression_ratio
from touchfield.medium import ForceField, Grid, HapticMedium

__all__ = ["OpenStream", "open_stream", "write_field"]


class OpenStream:
    """A ``.touch`` file, open for reading: its head, and its frames as a lazy medium."""

    def __init__(self, reader: TouchReader, file_bytes: int) -> None:
        self.reader, self.file_bytes = reader, file_bytes
        head = reader.head
        if head.coder != PaperDecoder.name:
            raise UnsupportedVersion(
                "HEAD.coder", repr(head.coder), repr(PaperDecoder.name), "A newer touchfield reads it."
            )
        self.grid = Grid(head.grid_shape, head.spacing_m, head.origin_m)
        self.decoder = PaperDecoder(self.grid, head.coder_parameters)
        self._cursor: tuple[int, Iterator[ForceField], int] | None = None
        self._latest: tuple[int, ForceField] | None = None

    @property
    def medium(self) -> HapticMedium:
        """The decoded medium; a frame costs the decoding of its segment up to it, or one frame in sequence."""
        head = self.reader.head
        return HapticMedium(
            self.grid, head.rate_hz, head.frame_count, self._frame, head.axes, head.friction,
            head.damping_n_s_per_m, tuple(head.tags), dict(self.reader.provenance),
        )  # fmt: skip

    def _frame(self, index: int) -> ForceField:
        if self._latest is not None and self._latest[0] == index:
            return self._latest[1]
        segment = self.reader.segment_of(index)
        if self._cursor is None or self._cursor[0] != segment or self._cursor[2] > index:
            entry = self.reader.segments[segment]
            frames = self.decoder.frames(self.reader.read_segment(segment), entry.frame_count)
            self._cursor = (segment, frames, entry.first_frame)
        _, frames, at = self._cursor
        self._cursor = None  # an error on the way leaves nothing half-read behind
        for _ in range(at, index + 1):
            decoded = next(frames)
        self._cursor = (segment, frames, index + 1)
        self._latest = (index, decoded)
        return decoded

    @cached_property
    def costs(self) -> tuple[FrameCost, ...]:
        """What each frame of the file cost; reads every segment once, and decodes none."""
        segments = enumerate(self.reader.segments)
        return tuple(
            cost for i, s in segments for cost in self.decoder.costs(self.reader.read_segment(i), s.frame_count)
        )

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        head = self.reader.head
        size = self.file_bytes
        account = sum((c.bits for c in self.costs), BitAccount())
        kinds = [c.kind.name for c in self.costs]
        return {
            "file_bytes": size,
            "frames": head.frame_count,
            "rate_hz": head.rate_hz,
            "seconds": head.frame_count / head.rate_hz,
            "segments": len(self.reader.segments),
            "grid_shape": list(head.grid_shape),
            "spacing_mm": [1e3 * h for h in head.spacing_m],
            "axes": head.axes,
            "device": head.device_name,
            "device_type": head.device_type,
            "force_max_n": head.force_max_n,
            "hand_metres_per_scene_metre": head.mapping_scale,
            "k": head.weber_fraction,
            "f0_n": head.force_threshold_n,
            "coder": head.coder,
            **self.decoder.describe(),
            "frame_kinds": {k.lower(): kinds.count(k) for k in dict.fromkeys(kinds)},
            "cr_full": compression_ratio(8 * size, head.frame_count, self.grid.voxel_count),
            "cr_literal": compression_ratio(
                account.amplitude + account.direction, head.frame_count, self.grid.voxel_count
            ),
            "provenance": dict(self.reader.provenance),
        }


@contextmanager
def open_stream(path: str | Path) -> Iterator[OpenStream]:
    """Open a ``.touch`` file; decoding takes no configuration."""
    with TouchReader(path) as reader:
        yield OpenStream(reader, Path(path).stat().st_size)


def write_field(path: str | Path, medium: HapticMedium, report: Report = silent) -> Path:
    """Write a medium as ``.npz`` or ``.vti``, by the ending of `path`; the file to open.

    Several frames as ``.vti`` are numbered files and a ``.pvd`` that lists them: that is the one to open.

    Raises
    ------
    InvalidArgument
        If the ending is another.
    """
    from touchfield.medium.npz import write_npz
    from touchfield.medium.vti import write_vti

    path = Path(path)

    def progress(done: int) -> None:
        report(done, len(medium))

    if path.suffix == ".npz":
        write_npz(path, medium, progress)
        return path
    if path.suffix == ".vti":
        return write_vti(path, medium, progress=progress)
    raise InvalidArgument(str(path), f"the ending {path.suffix!r}", "FIELD.npz or FIELD.vti")
