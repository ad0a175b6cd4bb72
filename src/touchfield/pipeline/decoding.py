"""Opens a ``.touch`` file as a stream of decoded frames, by the coder that it names, and writes such frames
to other formats (``.npz``, ``.zarr``, ``.vti``)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from touchfield.codec.registry import coder
from touchfield.compute.threads import Progress, silent
from touchfield.container import TouchReader
from touchfield.errors import InvalidArgument, naming_file
from touchfield.medium import HapticMedium
from touchfield.medium.budget import require_memory
from touchfield.medium.grid import Placement
from touchfield.pipeline.stream import OpenStream, VoxelStream


@contextmanager
def open_file(path: str | Path) -> Iterator[OpenStream]:
    """Open a ``.touch`` file, by its path or address; decoding needs no configuration."""
    with TouchReader(path) as reader:
        yield stream_of(reader)


def stream_of(reader: TouchReader) -> OpenStream:
    """The stream of a reader, by its coder.

    Raises UnsupportedVersion if there is no such coder.
    """
    with naming_file(reader.name):
        if coder(reader.head.coder).spec is not None:
            return VoxelStream(reader)
        from touchfield.pipeline.decoded_objects import SceneStream

        return SceneStream(reader)


def write_field(
    path: str | Path, medium: HapticMedium, report: Progress = silent, placement: Placement | None = None
) -> Path:
    """Write a medium as ``.npz``, ``.zarr`` or ``.vti``, by the ending of `path`; returns the file to open.

    Several frames as ``.vti`` are numbered files and a ``.pvd`` that lists them, which is the one to open.

    Raises InvalidArgument if the ending is another, or a dense frame would take more than
    `memory_budget_bytes`: a small file may have a large grid.
    """
    from touchfield.medium.stores.npz import write_npz
    from touchfield.medium.stores.vti import write_vti

    path = Path(path)
    attributes = placement.to_dict() if placement is not None else {}
    if path.suffix == ".zarr":
        from touchfield.medium.stores.zarr_store import write_zarr

        write_zarr(path, medium, report, attributes)
        return path
    subject, hint = (
        f"each dense frame of {medium.grid.shape} samples",
        "Keep the .touch file, or set TOUCHFIELD_MEMORY_GIB.",
    )
    require_memory(str(path), subject, 12 * medium.grid.voxel_count, hint)
    if path.suffix == ".npz":
        write_npz(path, medium, report, attributes)
        return path
    if path.suffix == ".vti":
        return write_vti(path, medium, report, attributes)
    raise InvalidArgument(str(path), f"the ending {path.suffix!r}", "FIELD.npz, FIELD.zarr or FIELD.vti")
