"""Runs general-purpose coders (such as xz, JPEG XL, zfp) for `rate.py`, to compare coder `touch` with them.

Lossless coders (xz, zstd -19, brotli, zpaq -m5, JPEG XL, Draco) receive quantised forces as symbols. The byte
coders among them receive several layouts, of which the best counts: all samples of the box, or a mask and the
list of the samples in it; with the components interleaved or separate. Lossy coders (zfp, SZ3, SPERR) receive
the components of the box as float32; at the error bound also after companding. The coded depth maps are in
`rate_source`. Coders that are not installed are skipped and named.
"""

from __future__ import annotations

import importlib
import lzma
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rate_symbols as lattices
from rate_fields import Volume
from rate_ours import paper_symbols
from touchfield.medium import ForceField

MAX_BYTES = 8_000_000
"""Total size of the layouts that are given to the coders.

The layouts are taken in the order of their size by a quick xz, and the best is always given. zpaq takes 3 s
for each megabyte.
"""
JPEG_XL_PIXELS = 500_000
"""Number of pixels from which JPEG XL takes effort 7 instead of 9."""

Symbols = NDArray[np.int32]
Forces = NDArray[np.float32]
Lossy = Callable[[Forces, float], tuple[int, Forces]]
MODULES = {
    "zstd -19": "zstandard",
    "brotli": "brotli",
    "zpaq -m5": "zpaq",
    "JPEG XL": "imagecodecs",
    "SPERR": "imagecodecs",
    "zfp": "zfpy",
    "SZ3": "pysz",
    "Draco": "DracoPy",
}


@cache
def module(peer: str) -> Any:
    """The library of a peer, or None."""
    try:
        return importlib.import_module(MODULES[peer])
    except ImportError:
        return None


def absent() -> list[str]:
    """Return the names of the peers that are not installed."""
    return [name for name in MODULES if module(name) is None]


# -- bytes to bytes ----------------------------------------------------------------------------------------


def xz(data: bytes) -> int:
    """Return the bytes by LZMA2 at its highest preset, without a container."""
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME}]
    return len(lzma.compress(data, format=lzma.FORMAT_RAW, filters=filters))


def quick_xz(data: bytes) -> int:
    """Return an estimate of `xz`, to choose layouts."""
    return len(lzma.compress(data, preset=1))


@cache
def compressors() -> dict[str, Callable[[bytes], int]]:
    """Return the installed byte coders; zpaq is one block with its model, no archive."""
    every: dict[str, Callable[[bytes], int]] = {
        "xz": xz,
        "zstd -19": lambda data: len(module("zstd -19").ZstdCompressor(level=19).compress(data)),
        "brotli": lambda data: len(module("brotli").compress(data, quality=11)),
        "zpaq -m5": lambda data: len(module("zpaq -m5").compress(data, level=5, threads=1)),
    }
    return {name: back for name, back in every.items() if name == "xz" or module(name)}


# -- layouts of symbols ------------------------------------------------------------------------------------


def plain(symbols: Symbols) -> NDArray[Any]:
    """Return the same numbers in the narrowest type that holds them."""
    for dtype in (np.int8, np.uint8, np.int16, np.uint16):
        limits = np.iinfo(dtype)
        if limits.min <= symbols.min(initial=0) and symbols.max(initial=0) <= limits.max:
            return symbols.astype(dtype)
    return symbols


def byte_planes(symbols: NDArray[Any]) -> bytes:
    """Return the low bytes, then the high bytes of symbols of more than one byte."""
    flat = np.ascontiguousarray(symbols).reshape(-1)
    return flat.view(np.uint8).reshape(-1, flat.itemsize).T.tobytes()


def layouts(symbols: Symbols) -> Iterator[tuple[bytes, NDArray[np.bool_] | None]]:
    """Yield byte layouts of symbols [frame, x, y, z, 3], each with its mask or None.

    The mask must be sent with the bytes. There are two layouts of the whole box and two of the list of the
    samples that are not zero, each with the components interleaved and separate. z is the fastest axis, along
    which a wall is thick. Several frames give further lists, of the voxels that are not zero in any frame,
    with the frames of a voxel side by side: interleaved, separate, and as differences between frames.
    """
    narrow = plain(symbols)
    by_voxel = np.moveaxis(narrow, 0, 3)  # [x, y, z, frame, 3]: the frames of a voxel side by side
    yield byte_planes(by_voxel), None
    yield byte_planes(np.moveaxis(narrow, -1, 0)), None
    support = (narrow != 0).any(axis=-1)
    yield byte_planes(narrow[support]), support
    yield byte_planes(narrow[support].T), support
    if len(narrow) > 1:
        union = support.any(axis=0, keepdims=True)
        lists = by_voxel[union[0]]  # [voxel, frame, 3]
        change = np.diff(lists.astype(np.int32), axis=1, prepend=0)
        for values in (lists, np.moveaxis(lists, -1, 0), plain(np.moveaxis(change, -1, 0))):
            yield byte_planes(values), union


def picture_bytes(planes: NDArray[Any], effort: int | None = None) -> int:
    """Return the bytes of slices [n, h, w, ...] by lossless JPEG XL.

    The slices are put side by side in one picture that is about square.
    """
    n, h, w, *rest = planes.shape
    across = max(1, round((n * h / w) ** 0.5))
    down = -(-n // across)
    filled = np.concatenate([planes, np.zeros((across * down - n, h, w, *rest), planes.dtype)])
    picture = filled.reshape(down, across, h, w, *rest).swapaxes(1, 2).reshape(down * h, across * w, *rest)
    effort = effort or (9 if picture.size < JPEG_XL_PIXELS else 7)
    encode = module("JPEG XL").jpegxl_encode
    return len(encode(np.ascontiguousarray(picture), lossless=True, effort=effort, numthreads=1))


def jpeg_xl(symbols: Symbols) -> int:
    """Return the bytes of slices as pictures of three colours by JPEG XL.

    The slices are taken across x or across y, whichever gives fewer bytes.
    """
    raised = symbols - min(0, int(symbols.min(initial=0)))
    raised = raised.astype(np.uint8 if raised.max(initial=0) < 256 else np.uint16)
    return min(picture_bytes(s.reshape(-1, *s.shape[2:])) for s in (raised, raised.swapaxes(1, 2)))


def mask_bytes(mask: NDArray[np.bool_], is_final: bool = True) -> int:
    """Return the bytes of a mask by the best of all lossless coders.

    The mask is coded as bits, and as pictures. Without `is_final` the result is a quick estimate.
    """
    packed = np.packbits(mask).tobytes()
    if not is_final:
        return quick_xz(packed)
    sizes = [back(packed) for back in compressors().values()]
    if module("JPEG XL"):
        sizes.append(picture_bytes(mask.reshape(-1, *mask.shape[2:]).astype(np.uint8) * 255))
    return min(*sizes, len(packed))


def list_bytes(values: Symbols, is_final: bool = True) -> int:
    """Return the bytes of a list [m, 3] by the best of all byte coders.

    Without `is_final` the result is a quick estimate.
    """
    data = byte_planes(plain(values).T)
    return min(back(data) for back in compressors().values()) if is_final else quick_xz(data)


def lossless(symbols: Symbols, of_forces: bool = True) -> dict[str, float]:
    """Return the bytes of symbols [frame, x, y, z, components] by each lossless coder.

    For each coder the best of the selected layouts counts (`MAX_BYTES`). Symbols that are not `of_forces` are
    given to xz and zpaq only.
    """
    candidates, masks = list(layouts(symbols)), dict[int, int]()
    for _, mask in candidates:
        if mask is not None and id(mask) not in masks:
            masks[id(mask)] = mask_bytes(mask)
    extra = [0 if mask is None else masks[id(mask)] for _, mask in candidates]
    order = sorted(range(len(candidates)), key=lambda i: quick_xz(candidates[i][0]) + extra[i])
    total = np.cumsum([len(candidates[i][0]) for i in order])
    selected = [i for n, i in enumerate(order) if not n or total[n] <= MAX_BYTES]
    found = {
        name: float(min(back(candidates[i][0]) + extra[i] for i in selected) + Volume.HEAD_BYTES)
        for name, back in compressors().items()
        if of_forces or name in ("xz", "zpaq -m5")
    }
    if of_forces and module("JPEG XL"):
        found["JPEG XL"] = jpeg_xl(symbols) + Volume.HEAD_BYTES
    if of_forces and module("Draco"):
        found["Draco"] = draco(symbols)
    return found


def draco(symbols: Symbols) -> int:
    """Return the bytes of a Draco point cloud for each frame.

    The points are the voxels that are not zero; their symbols are an attribute.
    """
    total, bits = 0, max(1, (max(symbols.shape[1:4]) - 1).bit_length())
    options = {
        "quantization_range": float(2**bits - 1),
        "quantization_origin": [0.0] * 3,
        "compression_level": 10,
    }
    for frame in symbols:
        support = (frame != 0).any(axis=-1)
        points, raised = (
            np.argwhere(support).astype(np.float32),
            (frame[support] - frame.min(initial=0)).astype(np.uint16),
        )
        cloud = module("Draco").encode(
            points, quantization_bits=bits, **options, preserve_order=False, generic_attributes={0: raised}
        )
        total += len(cloud)
    return total


# -- lossy -------------------------------------------------------------------------------------------------


def lossy() -> dict[str, Lossy]:
    """Return coders of float32 volumes [frame, x, y, z, 3] by an absolute tolerance.

    The tolerance is in newtons. Each coder returns ``(bytes, decoded)``.
    """

    def coded(code: Lossy, forces_n: Forces, tolerance: float) -> tuple[int, Forces]:
        volume = forces_n[0] if len(forces_n) == 1 else forces_n
        sizes, decoded = zip(*(code(np.ascontiguousarray(volume[..., c]), tolerance) for c in range(3)))
        return sum(sizes), np.stack(decoded, axis=-1).reshape(forces_n.shape)

    return {name: partial(coded, code) for name, code in LOSSY.items() if module(name)}


def _zfp(volume: Forces, tolerance: float) -> tuple[int, Forces]:
    data = module("zfp").compress_numpy(volume, tolerance=tolerance)
    return len(data), module("zfp").decompress_numpy(data)


def _sz3(volume: Forces, tolerance: float) -> tuple[int, Forces]:
    pysz, packed = module("SZ3"), []
    for algorithm in ("INTERP_LORENZO", "LORENZO_REG"):
        config = pysz.szConfig()
        config.errorBoundMode, config.absErrorBound = pysz.szErrorBoundMode.ABS, float(tolerance)
        config.cmprAlgo = getattr(pysz.szAlgorithm, algorithm)
        packed.append(pysz.sz.compress(volume, config)[0].copy())
    best = min(packed, key=len)
    return len(best), pysz.sz.decompress(best, np.float32, volume.shape)[0]


def _sperr(volume: Forces, tolerance: float) -> tuple[int, Forces]:
    codecs = module("SPERR")
    stacked = volume.reshape(-1, *volume.shape[-2:])  # frames are stacked along the first axis
    data = codecs.sperr_encode(stacked, float(tolerance), "pwe", numthreads=1)
    return len(data), np.asarray(codecs.sperr_decode(data, numthreads=1), np.float32).reshape(volume.shape)


LOSSY: dict[str, Lossy] = {"zfp": _zfp, "SZ3": _sz3, "SPERR": _sperr}
"""Coders of one component."""

# -- the contest --------------------------------------------------------------------------------------------


def at_error(volume: Volume, target_db: float) -> dict[str, float]:
    """Return the bytes of every peer at an NMSE of at most `target_db`.

    Each takes the coarsest tolerance or step that has it; NaN if none does.
    """
    forces, found = volume.forces_n, dict[str, float]()
    start = float(np.sqrt(12 * volume.energy / forces.size * 10 ** (target_db / 10)))

    def is_good(result: tuple[Any, Forces]) -> bool:
        return volume.nmse_db(result[1]) <= target_db

    for name, code in lossy().items():
        result = lattices.coarsest(partial(code, forces), is_good, start / 64, start * 64)
        found[name] = result[0] + Volume.HEAD_BYTES if result else np.nan
    quantised = lattices.coarsest(
        lambda step: lattices.uniform(forces, step), is_good, start / 64, start * 64
    )
    return found | (lossless(quantised.symbols) if quantised else {})


def at_promise(volume: Volume) -> dict[str, float]:
    """Return the bytes of every peer within the error bound at every voxel.

    Lossy coders are given plain or companded forces, whichever takes fewer bytes.
    """
    forces, found = volume.forces_n, dict[str, float]()
    for quantised in lattices.promised(forces):
        for name, size in lossless(quantised.symbols).items():
            found[name] = min(size, found.get(name, np.inf))
    bent = lattices.compand(forces).astype(np.float32)

    def is_kept(decode: Callable[[Any], Any], result: tuple[Any, Any]) -> bool:
        return lattices.is_within_bound(forces, decode(result[1]))

    for name, code in lossy().items():
        for values, start, decode in (
            (forces, lattices.F0_N, np.asarray),
            (bent, 1.0, lattices.expand),
        ):
            result = lattices.coarsest(
                partial(code, values), partial(is_kept, decode), start / 16, start * 4,
            )  # fmt: skip
            if result:
                found[name] = min(result[0] + Volume.HEAD_BYTES, found.get(name, np.inf))
    return found


def on_paper(frames: list[ForceField]) -> dict[str, float]:
    """Return the bytes of coder `paper`'s symbols by general coders.

    The frames are coded alone; the error is that of coder `paper`.
    """
    symbols, table_bytes = paper_symbols(frames)
    return {name: size + table_bytes for name, size in lossless(symbols, of_forces=False).items()}
