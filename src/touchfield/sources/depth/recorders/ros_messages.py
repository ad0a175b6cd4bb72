"""ROS 2 messages of a depth camera, decoded by mcap-ros2-support from their definitions (extra: mcap).

sensor_msgs/Image             16UC1, mono16 (millimetres, REP 118), 32FC1 (metres); any step and byte order
sensor_msgs/CompressedImage   compressed_depth_image_transport: a head of 12 bytes (ConfigHeader: int32,
                              a and b float32), then 16-bit samples as a PNG or RVL (`decode_rvl`).
                              Floats are quantised: depth = a / (value - b); 0 is unknown
sensor_msgs/CameraInfo        K, D and distortion_model of the picture as taken, P of the rectified one
tf2_msgs/TFMessage            transforms from child_frame_id to header.frame_id
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from io import BytesIO
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError, import_extra
from touchfield.files import library_faults
from touchfield.sources.images.pictures import MAX_PIXELS
from touchfield.sources.images.png_rows import require_all_rows

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, TRANSFORMS = "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
FLOAT = "std_msgs/msg/Float32"
_CONFIG: Final = struct.Struct("<iff")
_RVL_SIZE: Final = struct.Struct("<II")
_TRANSPORTS: Final = ("", "compressedDepth", "compressedDepth png", "compressedDepth rvl")
DEPTH_ENCODINGS: Final = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}

_LINE: Final = "\n" + 80 * "=" + "\n"
_TIME: Final = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_HEADER: Final = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_ROI: Final = (
    "MSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\n"
    "bool do_rectify\n"
)
_TRANSFORM: Final = (
    "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform\n",
    "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n",
    "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
)
DEFINITIONS: Final = {
    IMAGE: _LINE.join((
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
        "uint32 step\nuint8[] data\n", _HEADER, _TIME,
    )),
    COMPRESSED_IMAGE: _LINE.join((
        "std_msgs/Header header\nstring format\nuint8[] data\n", _HEADER, _TIME,
    )),
    CAMERA_INFO: _LINE.join((
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n"
        "float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\n"
        "sensor_msgs/RegionOfInterest roi\n", _HEADER, _TIME, _ROI,
    )),
    TRANSFORMS: _LINE.join((
        "geometry_msgs/TransformStamped[] transforms\n", *_TRANSFORM, _HEADER, _TIME,
    )),
    FLOAT: "float32 data\n",
}  # fmt: skip
"""Definitions by the name of the message, as an MCAP file stores them."""


@cache
def _decoder(kind: str) -> Callable[[bytes], Any]:
    module = import_extra("mcap_ros2.decoder", kind, "mcap-ros2-support", "mcap")
    records = import_extra("mcap.records", kind, "mcap", "mcap")
    number = 1 + list(DEFINITIONS).index(kind)
    schema = records.Schema(id=number, name=kind, encoding="ros2msg", data=DEFINITIONS[kind].encode())
    decode: Callable[[bytes], Any] = module.DecoderFactory().decoder_for("cdr", schema)
    return decode


def decode(kind: str, data: bytes, where: str) -> Any:
    """Decode a message, as an object with the fields of its definition.

    Raises `SourceError`, which names `where`, if it is cut short; `MissingExtra` without the library.
    """
    decoder = _decoder(kind)
    found = f"a message of {len(data)} bytes that cannot be decoded"
    with library_faults(where, found, kind, "Copy the bag again."):
        return decoder(data)


def stamp_s(header: Any) -> float:
    """Return the time of a message, seconds."""
    return float(header.stamp.sec) + float(header.stamp.nanosec) * 1e-9


def encoding_of(kind: str, message: Any) -> str:
    """Return the encoding of an image's samples, such as 16UC1; "" if it is no depth."""
    if kind == IMAGE:
        return str(message.encoding) if message.encoding in DEPTH_ENCODINGS else ""
    encoding, _, transport = str(message.format).partition(";")
    is_depth = encoding.strip() in DEPTH_ENCODINGS and (not transport or "compressedDepth" in transport)
    return encoding.strip() if is_depth else ""


def depth_values(kind: str, message: Any, where: str) -> NDArray[Any]:
    """Return the stored depth of an image, uint16 or float32 [height, width]."""
    data = bytes(message.data)
    if kind == COMPRESSED_IMAGE:
        return _decompressed(encoding_of(kind, message), str(message.format), data, where)
    sample = np.dtype((">" if message.is_bigendian else "<") + DEPTH_ENCODINGS[message.encoding])
    height, width, step = int(message.height), int(message.width), int(message.step)
    is_whole = step >= width * sample.itemsize and len(data) >= step * height
    if not (is_whole and 0 < width * height <= MAX_PIXELS):
        found = f"{len(data)} bytes for {width} x {height} pixels of {step} bytes a row"
        raise SourceError(where, found, f"whole rows of {message.encoding}", "Copy the bag again.")
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)
    values = np.ascontiguousarray(rows[:, : width * sample.itemsize]).view(sample)
    return values.astype(sample.newbyteorder("="))


def _decompressed(encoding: str, form: str, data: bytes, where: str) -> NDArray[Any]:
    """Return the samples of a compressed image; `form` is its format: "16UC1; compressedDepth png"."""
    transport = form.partition(";")[2].strip()
    if len(data) <= _CONFIG.size or transport not in _TRANSPORTS:
        mend = "Republish it: ros2 run image_transport republish compressedDepth raw."
        expected = f"a head of {_CONFIG.size} bytes and compressedDepth png or rvl"
        raise SourceError(where, f"{len(data)} bytes of {form!r}", expected, mend)
    _, a, b = _CONFIG.unpack_from(data)
    body = data[_CONFIG.size :]
    stored = decode_rvl(body, where) if transport.endswith("rvl") else _png_samples(body, where)
    if DEPTH_ENCODINGS[encoding] == "u2":
        return stored
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.float32(a) / (stored.astype(np.float32) - np.float32(b))
    return np.where(stored == 0, np.float32(0), depth)


def _png_samples(data: bytes, where: str) -> NDArray[np.uint16]:
    from PIL import Image

    with (
        library_faults(where, "no PNG after the head", "compressedDepth with PNG"),
        Image.open(BytesIO(data), formats=("PNG",)) as image,
    ):
        if image.width * image.height > MAX_PIXELS:
            raise SourceError(where, f"{image.width} x {image.height} pixels", f"at most {MAX_PIXELS}")
        stored = np.array(image).astype(np.uint16)
        require_all_rows(where, BytesIO(data), stored)
    if stored.ndim != 2:
        raise SourceError(where, f"samples of shape {stored.shape}", "a grey picture of 16 bits")
    return stored


def decode_rvl(data: bytes, where: str) -> NDArray[np.uint16]:
    """Decode an RVL image, uint16 [height, width] (Wilson, Fast lossless depth image compression, 2017).

    Width and height are uint32; then follow 32-bit words of eight nibbles, the highest first. A nibble has
    three bits of a number, the lowest first, and a bit that says that more follow. The numbers are the count
    of zeros, the count of other samples, and the differences of these from one to the next, with the sign in
    the lowest bit; and so on. Raises `SourceError`, which names `where`, for damaged bytes.
    """
    words = np.frombuffer(data[_RVL_SIZE.size :], "<u4", max(len(data) - _RVL_SIZE.size, 0) // 4)
    width, height = _RVL_SIZE.unpack_from(data) if len(words) else (0, 0)
    if not 0 < width * height <= MAX_PIXELS:
        found = f"{width} x {height} pixels in {len(data)} bytes"
        raise SourceError(where, found, "an RVL image", "Copy the bag again.")
    shifts = np.arange(28, -4, -4, dtype=np.uint32)
    nibbles = ((words[:, None] >> shifts) & 15).astype(np.uint8).ravel()
    samples = np.zeros(width * height, np.uint16)
    from touchfield.sources.depth.kernels.rvl import decode_nibbles

    if decode_nibbles(nibbles, samples) != len(samples):
        raise SourceError(where, "an RVL image that is cut short or damaged", f"{width} x {height} pixels")
    return samples.reshape(height, width)
