"""General-purpose coders of `rate.py`; missing ones are skipped and named.

Lossless ones (zstd -19, xz, brotli, zpaq at its most, JPEG XL) are given symbols in several layouts, the best
of which counts: the whole box, or a mask and the list of what is in it; components apart or together. Lossy
ones (zfp, SZ3, SPERR) are given the components of the box as float32, at the promise also companded. The
coded source is in `rate_source`.
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
"""Of the layouts that are given to the coders, the best by a quick xz first; the best is always given. zpaq
takes 3 s for each megabyte."""
JPEG_XL_PIXELS = 500_000
"""Of larger pictures JPEG XL searches a little less."""

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
    """The names of the peers that are not installed."""
    return [name for name in MODULES if module(name) is None]


# -- bytes to bytes ----------------------------------------------------------------------------------------


def xz(data: bytes) -> int:
    """LZMA2 at its highest preset, without a container."""
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME}]
    return len(lzma.compress(data, format=lzma.FORMAT_RAW, filters=filters))


def quick_xz(data: bytes) -> int:
    """An estimate of `xz`, for choosing layouts."""
    return len(lzma.compress(data, preset=1))


@cache
def compressors() -> dict[str, Callable[[bytes], int]]:
    """Installed lossless coders; zpaq is one block with its model, without an archive."""
    every: dict[str, Callable[[bytes], int]] = {
        "xz": xz,
        "zstd -19": lambda data: len(module("zstd -19").ZstdCompressor(level=19).compress(data)),
        "brotli": lambda data: len(module("brotli").compress(data, quality=11)),
        "zpaq -m5": lambda data: len(module("zpaq -m5").compress(data, level=5, threads=1)),
    }
    return {name: back for name, back in every.items() if name == "xz" or module(name)}


# -- layouts of symbols ------------------------------------------------------------------------------------


def plain(symbols: Symbols) -> NDArray[Any]:
    """The same numbers in the narrowest type that holds them."""
    for dtype in (np.int8, np.uint8, np.int16, np.uint16):
        limits = np.iinfo(dtype)
        if limits.min <= symbols.min(initial=0) and symbols.max(initial=0) <= limits.max:
            return symbols.astype(dtype)
    return symbols


def byte_planes(symbols: NDArray[Any]) -> bytes:
    """Low bytes, then high bytes where a symbol takes more than one."""
    flat = np.ascontiguousarray(symbols).reshape(-1)
    return flat.view(np.uint8).reshape(-1, flat.itemsize).T.tobytes()


def layouts(symbols: Symbols) -> Iterator[tuple[bytes, NDArray[np.bool_] | None]]:
    """Bytes, and the mask that must be sent beside them; symbols are [frame, x, y, z, 3].

    The box and the list of what is not zero, each with components in turn and apart. z is fastest, along
    which a wall is thick. Of several frames also a list for each voxel that any of them holds, its frames
    side by side: in turn, apart, and as changes.
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
    """Slices [n, h, w, ...] by JPEG XL without loss, side by side in one picture that is about square."""
    n, h, w, *rest = planes.shape
    across = max(1, round((n * h / w) ** 0.5))
    down = -(-n // across)
    filled = np.concatenate([planes, np.zeros((across * down - n, h, w, *rest), planes.dtype)])
    picture = filled.reshape(down, across, h, w, *rest).swapaxes(1, 2).reshape(down * h, across * w, *rest)
    effort = effort or (9 if picture.size < JPEG_XL_PIXELS else 7)
    encode = module("JPEG XL").jpegxl_encode
    return len(encode(np.ascontiguousarray(picture), lossless=True, effort=effort, numthreads=1))


def jpeg_xl(symbols: Symbols) -> int:
    """Slices as pictures of three colours, across x or across y, whichever is smaller."""
    raised = symbols - min(0, int(symbols.min(initial=0)))
    raised = raised.astype(np.uint8 if raised.max(initial=0) < 256 else np.uint16)
    return min(picture_bytes(s.reshape(-1, *s.shape[2:])) for s in (raised, raised.swapaxes(1, 2)))


def mask_bytes(mask: NDArray[np.bool_], is_final: bool = True) -> int:
    """A mask by the best of all lossless coders, as bits, and as pictures; or about as many bytes,
    quickly.
    """
    packed = np.packbits(mask).tobytes()
    if not is_final:
        return quick_xz(packed)
    sizes = [back(packed) for back in compressors().values()]
    if module("JPEG XL"):
        sizes.append(picture_bytes(mask.reshape(-1, *mask.shape[2:]).astype(np.uint8) * 255))
    return min(*sizes, len(packed))


def list_bytes(values: Symbols, is_final: bool = True) -> int:
    """A list [m, 3] by the best of all; or about as many bytes, quickly."""
    data = byte_planes(plain(values).T)
    return min(back(data) for back in compressors().values()) if is_final else quick_xz(data)


def lossless(symbols: Symbols, of_forces: bool = True) -> dict[str, float]:
    """Bytes by each coder of symbols [frame, x, y, z, components], the best of the layouts that there is time
    for.

    Of symbols that are not `of_forces` no picture and no cloud is made; they go to xz and zpaq alone.
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
    """A cloud of the voxels that are not zero, their symbols as an attribute, one cloud for each frame."""
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
    """Coders of float32 volumes by an absolute tolerance, newtons: ``(bytes, decoded)`` of [frame, x, y, z,
    3].
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
    stacked = volume.reshape(-1, *volume.shape[-2:])  # of frames, one volume after another
    data = codecs.sperr_encode(stacked, float(tolerance), "pwe", numthreads=1)
    return len(data), np.asarray(codecs.sperr_decode(data, numthreads=1), np.float32).reshape(volume.shape)


LOSSY: dict[str, Lossy] = {"zfp": _zfp, "SZ3": _sz3, "SPERR": _sperr}
"""Of one component."""

# -- the contest --------------------------------------------------------------------------------------------


def at_error(volume: Volume, target_db: float) -> dict[str, float]:
    """Bytes of every peer at the coarsest tolerance or step with at most that NMSE; NaN where none has it."""
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
    """Bytes of every peer within the error bound at every voxel; lossy ones plain or companded."""
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
    """Bytes by general coders of what coder `paper` sends of frames coded alone; their error is its own."""
    symbols, table_bytes = paper_symbols(frames)
    return {name: size + table_bytes for name, size in lossless(symbols, of_forces=False).items()}
