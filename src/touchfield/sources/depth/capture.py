"""Captures depth images live: from a camera, from a folder that grows, or from pictures on standard input.

A captured sequence has no known end. Each frame shows the newest picture, so that a consumer that keeps up
gets current data: pictures that arrive faster than frames are requested are skipped, and while a picture is
late the last one is repeated. Pictures on standard input are shown one by one, and their writer waits; a
frame that is left out takes a picture, too. A recent frame is the same when it is requested again; older
frames are gone.
"""

from __future__ import annotations

import struct
import time
from abc import ABC, abstractmethod
from collections import deque
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Condition, Thread
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s
from touchfield.errors import InvalidArgument, SourceError, import_extra
from touchfield.files import read_up_to, standard_input
from touchfield.sources.camera import DepthCode, DepthSequence
from touchfield.sources.depth.depth_check import stored_notes
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.depth.intrinsics_file import camera_of
from touchfield.sources.depth.layouts import required_scale, source_rate
from touchfield.sources.depth.lens import undistortion
from touchfield.sources.images.pictures import PICTURE_SUFFIXES, list_files, read_picture, with_suffix

if TYPE_CHECKING:
    from collections.abc import Callable

    from touchfield.sources.camera import Intrinsics
    from touchfield.sources.options import SourceOptions
    from touchfield.sources.scene import Scene


MAX_CAPTURED_FRAMES: Final = 1 << 20  # frames of a captured sequence: nine hours at 30 Hz
TIMEOUT_S: Final = 10.0  # the sequence ends if no picture arrives for this long
_CACHED_FRAMES: Final = 4
_POLL_S: Final = 0.005
_WRITE_GRACE_S: Final = 1.0
_PNG: Final = b"\x89PNG\r\n\x1a\n"
_MAX_PNG_BYTES: Final = 1 << 28


class CaptureEnd(SourceError):
    """The source has no more pictures."""


class Pictures(ABC):
    """A stream of pictures.

    If `in_order`, every picture is shown and its writer waits; otherwise only the newest picture is shown.
    """

    name: str
    in_order = False

    @abstractmethod
    def next(self) -> NDArray[Any]:
        """Wait for the next picture, stored values [height, width].

        Raises `CaptureEnd` at the end.
        """

    def close(self) -> None:
        """Release the resources of the stream."""
        return


class GrowingFolder(Pictures):
    """Pictures that are added to a folder.

    The picture shown is the last one in the order of their numbers, whenever that changes.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            expected = "a folder into which depth pictures are put"
            raise SourceError(str(folder), "no folder", expected, "Check the path.")
        self.name, self._folder = str(folder), folder
        self._last: Path | None = None

    def next(self) -> NDArray[Any]:
        """See `Pictures.next`; raises `CaptureEnd` at once if the folder disappears.

        A picture that is still being written is retried for a second, then skipped.
        """
        deadline = time.monotonic() + TIMEOUT_S
        candidate: Path | None = None
        since = 0.0  # when the candidate appeared
        while (now := time.monotonic()) < deadline:
            files = list_files(self._folder, with_suffix(*PICTURE_SUFFIXES))
            if not files and not self._folder.is_dir():
                raise CaptureEnd(self.name, "no folder any more", "a folder that grows")
            if candidate is None and files and files[-1] != self._last:
                candidate, since = files[-1], time.monotonic()
            if candidate is not None:
                self._last = candidate
                try:
                    return read_picture(candidate)
                except SourceError:
                    if time.monotonic() > since + _WRITE_GRACE_S:
                        candidate = None
            time.sleep(max(_POLL_S, time.monotonic() - now))  # limits the load of listing a large folder
        raise CaptureEnd(self.name, f"no new picture for {TIMEOUT_S:g} s", "a folder that grows")


class PipedPictures(Pictures):
    """Concatenated PNG pictures, as ``ffmpeg -f image2pipe`` writes them."""

    name, in_order = "standard input", True

    def __init__(self, stream: IO[bytes] | None = None) -> None:
        self._stream = stream or standard_input()
        self._folder = TemporaryDirectory(prefix="touchfield-")

    def next(self) -> NDArray[Any]:
        data = bytearray(read_up_to(self._stream, len(_PNG)))
        if not data:
            raise CaptureEnd(self.name, "its end", "a picture")
        if data != _PNG:
            raise SourceError(self.name, f"{bytes(data)!r}", "PNG pictures one behind the other")
        kind = b""
        while kind != b"IEND":
            head = read_up_to(self._stream, 8)
            length, kind = struct.unpack(">I4s", head.ljust(8, b"\0"))
            if len(data) + length > _MAX_PNG_BYTES:
                raise SourceError(self.name, f"a picture of more than {_MAX_PNG_BYTES} bytes", "fewer")
            rest = read_up_to(self._stream, length + 4)
            if len(rest) < length + 4:
                raise CaptureEnd(self.name, "its end in the middle of a picture", "whole pictures")
            data += head + rest
        path = Path(self._folder.name) / "picture.png"
        path.write_bytes(data)
        return read_picture(path)

    def close(self) -> None:
        self._folder.cleanup()


class OpencvCamera(Pictures):
    """A depth camera that OpenCV reads.

    `device` is the number of the camera, or any other source that `cv2.VideoCapture` accepts.
    """

    def __init__(self, device: str) -> None:
        cv2 = import_extra("cv2", "a camera", "opencv-python-headless", "camera")
        self.name = f"camera:{device}"
        backend = cv2.CAP_IMAGES if "%" in device else cv2.CAP_ANY  # an image sequence keeps all its bits
        logging = cv2.utils.logging
        level = logging.setLogLevel(logging.LOG_LEVEL_ERROR)  # its warnings say no more than the error below
        self._camera = cv2.VideoCapture(int(device) if device.isdigit() else device, backend)
        logging.setLogLevel(level)
        if not self._camera.isOpened():
            hint = "Is it connected? watch:FOLDER takes pictures that a program of the camera writes."
            raise SourceError(
                self.name, "no camera that OpenCV can open", "its number, such as camera:0", hint
            )
        self._camera.set(cv2.CAP_PROP_CONVERT_RGB, 0)  # keep 16 bits if the main picture has them
        self._depth_map = cv2.CAP_OPENNI_DEPTH_MAP  # 0, which is the main picture of other cameras

    def next(self) -> NDArray[Any]:
        is_grabbed = self._camera.grab()
        is_grabbed, picture = self._camera.retrieve(None, self._depth_map) if is_grabbed else (False, None)
        if not is_grabbed:
            raise CaptureEnd(self.name, "no further picture", "a camera that is on")
        return np.asarray(picture)

    def close(self) -> None:
        self._camera.release()


class CapturedSequence(DepthSequence):
    """Depth of captured pictures (see the module).

    `frame_count` is an upper bound. `arrived_s` is the time of the monotonic clock at which the picture shown
    last arrived, and `passed_over` counts pictures that a newer one replaced before they were shown.

    Raises `SourceError` if no first picture arrives, or it holds no depth.
    """

    is_captured = True

    def __init__(
        self,
        pictures: Pictures,
        options: SourceOptions,
        folders: tuple[Path, ...] = (),
        scale: float | None = None,
    ) -> None:
        self.name, self._pictures = pictures.name, pictures
        self._condition, self._pending = Condition(), deque[Any](maxlen=None if pictures.in_order else 1)
        self._frames: dict[int, Float32s] = {}
        self._error: SourceError | None = None
        self._is_closed = False
        self.arrived_s, self.passed_over = time.monotonic(), 0
        Thread(target=self._run, daemon=True, name="touchfield-capture").start()
        first = self._newest()
        if first is None:
            raise self._error or SourceError(self.name, f"no picture for {TIMEOUT_S:g} s", "depth pictures")
        if first.ndim != 2 or first.dtype.itemsize < 2:
            raise SourceError(
                self.name, f"a picture {first.shape} of {first.dtype}", "16-bit (or float) grey depth"
            )
        height, width = first.shape
        camera = camera_of(self.name, options.intrinsics, folders, (width, height))
        stated = options.depth_scale or camera.units_per_m
        code = DepthCode(required_scale(self.name, stated or scale, first.dtype.kind == "f"))
        undistort, lens_notes = undistortion(camera.lens, (width, height))
        self._metres: Callable[[NDArray[Any]], Float32s] = code
        if undistort is not None:
            self._metres = lambda values: undistort(code(values))
        self.frame_count, self.width, self.height = MAX_CAPTURED_FRAMES, width, height
        self.intrinsics: Intrinsics = camera.intrinsics
        self.rate_hz, self.notes = source_rate(options), (*camera.notes, *lens_notes)
        self.notes += stored_notes([first], code, stated is None)
        self._latest = self._frames[0] = self._metres(first)

    def depth_m(self, frame: int) -> Float32s:
        """See `DepthSequence.depth_m`.

        A frame that was not requested before shows the current picture.

        Raises `CaptureEnd` if there are no more pictures.
        """
        if frame not in self._frames:
            picture = self._newest()
            if picture is None and self._error is not None:
                raise self._error
            if picture is not None:
                self._latest = self._metres(picture)
            self._frames[frame] = self._latest
            while len(self._frames) > _CACHED_FRAMES:
                del self._frames[next(iter(self._frames))]
        return self._frames[frame]

    def skip_frame(self, frame: int) -> None:
        """See `DepthSequence.skip_frame`: of pictures in order, the next one is not shown if it is there."""
        with self._condition:
            if self._pictures.in_order and self._pending:
                self._pending.popleft()
                self._condition.notify_all()

    def close(self) -> None:
        """Stop capturing."""
        with self._condition:
            self._is_closed = True
            self._condition.notify_all()

    def _newest(self) -> NDArray[Any] | None:
        """Return the picture to show next; None if there is no new picture or the stream has ended."""
        with self._condition:
            if self._pictures.in_order or not self._frames:
                self._condition.wait_for(lambda: self._pending or self._error, TIMEOUT_S)
            self.arrived_s, picture = self._pending.popleft() if self._pending else (self.arrived_s, None)
            self._condition.notify_all()
        return picture

    def _run(self) -> None:
        try:
            while not self._is_closed:
                picture = self._pictures.next()
                with self._condition:
                    if self._pictures.in_order:  # a queue of two, then the writer waits
                        self._condition.wait_for(lambda: len(self._pending) < 2 or self._is_closed)
                    self.passed_over += len(self._pending) == self._pending.maxlen
                    self._pending.append((time.monotonic(), picture))
                    self._condition.notify_all()
        except Exception as error:  # including those of drivers: a waiting consumer must be notified
            with self._condition:
                wrapped = SourceError(self.name, str(error) or type(error).__name__, "pictures")
                self._error = error if isinstance(error, SourceError) else wrapped
                self._condition.notify_all()
        finally:
            self._pictures.close()


def open_capture(source: object, options: SourceOptions) -> Scene | None:
    """Open ``camera:N``, ``watch:FOLDER`` or ``-`` as a scene.

    Returns None for any other source.

    Raises `SourceError` if no picture arrives, `InvalidArgument` for options that need all pictures at once.
    """
    prefix, _, location = str(source).partition(":") if isinstance(source, str) else ("", "", "")
    if prefix not in ("camera", "watch", "-") or (prefix == "-") == bool(location):
        return None
    if options.reading != "camera" or options.segment is not None or options.poses is not None:
        found = "an option of pictures that are all there"
        raise InvalidArgument("--reading, --segment or --poses", found, "none of them", "Leave it out.")
    if prefix == "camera":
        sequence = CapturedSequence(OpencvCamera(location), options, (), 1000.0)
    elif prefix == "watch":
        sequence = CapturedSequence(GrowingFolder(Path(location)), options, (Path(location),))
    else:
        sequence = CapturedSequence(PipedPictures(), options)
    if options.world == "causal":
        return FusedScene(sequence, "causal")
    scene = DepthScene(sequence, frame="camera")
    scene.notes = (
        *scene.notes,
        "Each picture is rendered alone; --world causal fuses those of a static camera.",
    )
    return scene
