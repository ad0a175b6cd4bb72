"""The general-purpose coders of `rate.py`: what is not installed is left out and named.

Lossless ones (zstd -19, xz, brotli, zpaq -m5, JPEG XL) are given symbols in several layouts, the best of which
counts: the whole box, or a mask and the list of what is in it; components apart or together. Lossy
ones (zfp, SZ3, SPERR) are given the components of the box as float32.
"""

from __future__ import annotations

import hashlib
import importlib
import lzma
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchfield.parallel import worker_count

MOST_ZPAQ_BYTES = 8_000_000
"""Of the layouts that zpaq is given, together: it takes 3 s for each megabyte. One may be half as long again."""
LONG_BYTES = 1_000_000
"""Of longer layouts the slow coders take fewer."""
LAYOUTS = 3

_ZPAQ_TAG = bytes.fromhex("376b5374a03183d38cb228b0d3")
"""What each block of an archive begins with."""
_ZPAQ_DATA = re.compile(rb"jDC\d{14}d\d{10}")
"""The name of a block of data; those with c, h and i in place of d are bookkeeping."""

Symbols = NDArray[np.int32]
Lossy = Callable[[NDArray[np.float32], float], tuple[int, NDArray[np.float32]]]


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


# -- bytes to bytes --------------------------------------------------------------------------------------------


def xz(data: bytes) -> int:
    """LZMA2 at its most, without a container."""
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME}]
    return len(lzma.compress(data, format=lzma.FORMAT_RAW, filters=filters))


def zpaq(data: bytes) -> int:
    """zpaq -m5: the blocks of data with the model that decodes them, without the archive's three of bookkeeping."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "a").write_bytes(data)
        call = ["zpaq", "a", "o.zpaq", "a", "-m5", "-t1"]
        subprocess.run(call, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        blocks = (Path(folder) / "o.zpaq").read_bytes().split(_ZPAQ_TAG)[1:]
    return sum(len(_ZPAQ_TAG) + len(block) for block in blocks if _ZPAQ_DATA.search(block))


@cache
def back_ends() -> dict[str, Callable[[bytes], int]]:
    """Those that are here, zpaq last."""
    found: dict[str, Callable[[bytes], int]] = {"xz": xz}
    if zstandard := _module("zstandard"):
        found["zstd -19"] = lambda data: len(zstandard.ZstdCompressor(level=19).compress(data))
    if brotli := _module("brotli"):
        found["brotli"] = lambda data: len(brotli.compress(data, quality=11))
    if shutil.which("zpaq"):
        found["zpaq -m5"] = zpaq
    return found


def absent() -> list[str]:
    """The names of the peers that are not installed."""
    modules = {
        "zstd -19": "zstandard",
        "brotli": "brotli",
        "JPEG XL, SPERR": "imagecodecs",
        "zfp": "zfpy",
        "SZ3": "pysz",
        "Draco": "DracoPy",
    }
    lost = [name for name, module in modules.items() if _module(module) is None]
    return lost + ([] if shutil.which("zpaq") else ["zpaq -m5"])


# -- layouts of symbols ----------------------------------------------------------------------------------------


def plain(symbols: Symbols) -> NDArray[Any]:
    """The same numbers in the narrowest type that holds them."""
    for dtype in (np.int8, np.uint8, np.int16, np.uint16):
        limits = np.iinfo(dtype)
        if limits.min <= symbols.min(initial=0) and symbols.max(initial=0) <= limits.max:
            return symbols.astype(dtype)
    return symbols


def _bytes(symbols: NDArray[Any]) -> bytes:
    """Low bytes, then high bytes where a symbol takes more than one."""
    flat = np.ascontiguousarray(symbols).reshape(-1)
    if flat.itemsize == 1:
        return flat.tobytes()
    return flat.view(np.uint8).reshape(-1, flat.itemsize).T.tobytes()


def layouts(symbols: Symbols) -> Iterator[tuple[str, bytes, NDArray[np.bool_] | None]]:
    """Name, bytes, and the mask that must be sent beside them; symbols are [frame, x, y, z, 3].

    z is fastest, along which a wall is thick (across it all did worse). Of several frames also a list for each
    voxel that any of them holds, its frames side by side.
    """
    narrow = plain(symbols)
    still = np.moveaxis(narrow, 0, 3)  # [x, y, z, frame, 3]: the frames of a voxel side by side
    yield "box, in turn", _bytes(still), None
    yield "box, planes", _bytes(np.moveaxis(narrow, -1, 0)), None
    held = (narrow != 0).any(axis=-1)
    values = narrow[held]
    yield "list, in turn", _bytes(values), held
    yield "list, planes", _bytes(values.T), held
    if len(narrow) > 1:
        union = held.any(axis=0)
        lists = still[union]  # [voxel, frame, 3]
        yield "list, frames in turn", _bytes(lists), union[None]
        yield "list, planes of frames in turn", _bytes(np.moveaxis(lists, -1, 0)), union[None]
        change = np.diff(lists.astype(np.int32), axis=1, prepend=0)
        yield "list, changes in turn", _bytes(plain(np.moveaxis(change, -1, 0))), union[None]


def _mosaic(planes: NDArray[Any]) -> NDArray[Any]:
    """Slices [n, h, w, ...] side by side in one picture that is about square."""
    n, h, w = planes.shape[:3]
    across = max(1, round((n * h / w) ** 0.5))
    down = -(-n // across)
    filled = np.zeros((across * down, *planes.shape[1:]), planes.dtype)
    filled[:n] = planes
    tiles = filled.reshape(down, across, h, w, *planes.shape[3:])
    return np.ascontiguousarray(tiles.swapaxes(1, 2)).reshape(down * h, across * w, *planes.shape[3:])


def _jpeg_xl(planes: NDArray[Any]) -> int:
    codecs = _module("imagecodecs")
    picture = _mosaic(planes)
    effort = 9 if picture.size < 500_000 else 7
    return len(codecs.jpegxl_encode(picture, lossless=True, effort=effort, numthreads=1))


def _pictures(symbols: Symbols) -> NDArray[Any]:
    raised = symbols - min(0, int(symbols.min(initial=0)))
    return raised.astype(np.uint8 if raised.max(initial=0) < 256 else np.uint16)


def jpeg_xl(symbols: Symbols) -> int:
    """Lossless slices as pictures of three colours, across x or across y, whichever is smaller."""
    s = _pictures(symbols)
    return min(
        _jpeg_xl(s.reshape(-1, *s.shape[2:])), _jpeg_xl(s.swapaxes(1, 2).reshape(-1, *s.swapaxes(1, 2).shape[2:]))
    )


def mask_bytes(held: NDArray[np.bool_]) -> int:
    """A mask by the best of all lossless coders, as bits, and as pictures."""
    packed = np.packbits(held).tobytes()
    sizes = [back(packed) for back in back_ends().values()]
    if _module("imagecodecs"):
        sizes.append(_jpeg_xl(held.reshape(-1, *held.shape[2:]).astype(np.uint8) * 255))
    return min(*sizes, len(packed))


_known: dict[bytes, dict[str, int]] = {}


def lossless(symbols: Symbols, of_forces: bool = True) -> dict[str, int]:
    """Bytes by each coder of symbols [frame, x, y, z, components], the best layout of each.

    Short layouts are all given to xz and zstd, and the three that xz does best with to zpaq, two to brotli; of long
    ones a quick xz chooses three for xz, zstd and zpaq (as far as it has the time), and one for brotli. Symbols that
    are not `of_forces`, so that no picture and no cloud is made of them, go to xz and zpaq alone.
    """
    key = hashlib.sha256(repr((symbols.shape, of_forces)).encode() + np.ascontiguousarray(symbols).data).digest()
    if key not in _known:
        _known[key] = _lossless(symbols, of_forces)
    return _known[key]


def _lossless(symbols: Symbols, of_forces: bool) -> dict[str, int]:
    made = list(layouts(symbols))
    backs = {name: back for name, back in back_ends().items() if of_forces or name in ("xz", "zpaq -m5")}
    is_long = len(made[0][1]) > LONG_BYTES
    with ThreadPoolExecutor(worker_count()) as pool:
        picture = pool.submit(jpeg_xl, symbols) if of_forces and _module("imagecodecs") else None
        masks = {id(m): pool.submit(mask_bytes, m) for _, _, m in made if m is not None}
        extra = [0 if m is None else masks[id(m)].result() for _, _, m in made]
        chosen = list(range(len(made)))
        if is_long:
            quick = list(pool.map(_quick_xz, [data for _, data, _ in made]))
            chosen = sorted(chosen, key=lambda i: quick[i] + extra[i])[:LAYOUTS]
        by_xz = dict(zip(chosen, pool.map(xz, [made[i][1] for i in chosen])))
        order = sorted(chosen, key=lambda i: by_xz[i] + extra[i])
        taken = {"zstd -19": order, "brotli": order[: 1 if is_long else 2], "zpaq -m5": _for_zpaq(made, order)}
        jobs = {
            name: [pool.submit(back, made[i][1]) for i in taken[name]] for name, back in backs.items() if name != "xz"
        }
        found = {"xz": min(by_xz[i] + extra[i] for i in chosen)}
        for name, each in jobs.items():
            if each:
                found[name] = min(job.result() + extra[i] for job, i in zip(each, taken[name]))
        if picture is not None:
            found["JPEG XL"] = picture.result()
    return found


def _quick_xz(data: bytes) -> int:
    return len(lzma.compress(data, preset=1))


def first_guess(symbols: Symbols) -> int:
    """Bytes of the lists alone by a quick xz: to choose among lattices with."""
    values = plain(symbols)[(symbols != 0).any(axis=-1)]
    return _quick_xz(_bytes(values.T))


def _for_zpaq(made: list[tuple[str, bytes, NDArray[np.bool_] | None]], order: list[int]) -> list[int]:
    """The best layouts, three of them or as many as are not too long together."""
    chosen: list[int] = []
    for i in order:
        most = MOST_ZPAQ_BYTES if chosen else 1.5 * MOST_ZPAQ_BYTES
        if len(chosen) < LAYOUTS and sum(len(made[j][1]) for j in (*chosen, i)) <= most:
            chosen.append(i)
    return chosen


# -- lossy ------------------------------------------------------------------------------------------------------


def lossy() -> dict[str, Lossy]:
    """Coders of float32 volumes by an absolute tolerance, newtons: ``(bytes, decoded)`` of [frame, x, y, z, 3]."""
    found: dict[str, Lossy] = {}
    if _module("zfpy"):
        found["zfp"] = _by_component(_zfp)
    if _module("pysz"):
        found["SZ3"] = _by_component(_sz3)
    if _module("imagecodecs"):
        found["SPERR"] = _by_component(_sperr)
    return found


def _by_component(code: Callable[[NDArray[np.float32], float], tuple[int, NDArray[np.float32]]]) -> Lossy:
    def coded(forces_n: NDArray[np.float32], tolerance: float) -> tuple[int, NDArray[np.float32]]:
        one = forces_n[0] if len(forces_n) == 1 else forces_n
        with ThreadPoolExecutor(worker_count()) as pool:
            parts = list(pool.map(lambda c: code(np.ascontiguousarray(one[..., c]), tolerance), range(3)))
        decoded = np.stack([part for _, part in parts], axis=-1).reshape(forces_n.shape)
        return sum(size for size, _ in parts), decoded

    return coded


def _zfp(volume: NDArray[np.float32], tolerance: float) -> tuple[int, NDArray[np.float32]]:
    zfpy = _module("zfpy")
    data = zfpy.compress_numpy(volume, tolerance=tolerance)
    return len(data), zfpy.decompress_numpy(data)


def _sz3(volume: NDArray[np.float32], tolerance: float) -> tuple[int, NDArray[np.float32]]:
    pysz = _module("pysz")
    best = None
    for algorithm in ("INTERP_LORENZO", "LORENZO_REG"):
        config = pysz.szConfig()
        config.errorBoundMode, config.absErrorBound = pysz.szErrorBoundMode.ABS, float(tolerance)
        config.cmprAlgo = getattr(pysz.szAlgorithm, algorithm)
        data, _ = pysz.sz.compress(volume, config)
        if best is None or len(data) < len(best):
            best = data.copy()
    assert best is not None
    decoded, _ = pysz.sz.decompress(best, np.float32, volume.shape)
    return len(best), decoded


def _sperr(volume: NDArray[np.float32], tolerance: float) -> tuple[int, NDArray[np.float32]]:
    codecs = _module("imagecodecs")
    stacked = volume.reshape(-1, *volume.shape[-2:])  # of frames, one volume after another
    data = codecs.sperr_encode(stacked, float(tolerance), "pwe", numthreads=1)
    return len(data), np.asarray(codecs.sperr_decode(data, numthreads=1), np.float32).reshape(volume.shape)


def draco(symbols: Symbols) -> int | None:
    """A cloud of the voxels that are not zero, their symbols as an attribute, one cloud for each frame."""
    module = _module("DracoPy")
    if module is None:
        return None
    total = 0
    for frame in symbols:
        held = (frame != 0).any(axis=-1)
        bits = max(1, int(max(frame.shape[:3]) - 1).bit_length())
        raised = (frame[held] - frame.min(initial=0)).astype(np.uint16)
        total += len(
            module.encode(
                np.argwhere(held).astype(np.float32),
                quantization_bits=bits,
                quantization_range=float(2**bits - 1),
                quantization_origin=[0.0, 0.0, 0.0],
                compression_level=10,
                preserve_order=False,
                generic_attributes={0: raised},
            )
        )
    return total
