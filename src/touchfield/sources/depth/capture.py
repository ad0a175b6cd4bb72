"""Depth pictures that are taken while they are felt: a camera, a folder that grows, pictures on standard
input.

A captured sequence has no end that is known. Frame by frame it shows the newest picture there is, so that
whoever asks in time feels the present: pictures that come faster than they are asked for are passed over, and
one that is late leaves the last one standing. Pictures on standard input are shown one by one, and whoever
writes them waits. A frame that was asked for lately is the same when it is asked for again; older ones are
gone.
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
from touchfield.files import exactly, standard_input
from touchfield.sources.camera import DepthCode, DepthSequence
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.depth.intrinsics_file import camera_of
from touchfield.sources.depth.layouts import required_scale, source_rate
from touchfield.sources.images.pictures import PICTURE_SUFFIXES, list_files, read_picture, with_suffix

if TYPE_CHECKING:
    from collections.abc import Callable

    from touchfield.sources.camera import Intrinsics
    from touchfield.sources.options import SourceOptions
    from touchfield.sources.scene import Scene


MOST_FRAMES: Final = 1 << 20  # frames of a captured sequence: nine hours at 30 Hz
PATIENCE_S: Final = 10.0  # where no picture comes for so long, the sequence is over
_KEPT: Final = 4
_LOOK_S: Final = 0.005
_UNFINISHED_S: Final = 1.0
_PNG: Final = b"\x89PNG\r\n\x1a\n"
_MOST_PNG_BYTES: Final = 1 << 28


class CaptureEnd(SourceError):
    """There are no more pictures."""


class Pictures(ABC):
    """Where pictures come from: of each the newest is shown, or `in_order` each, while its source waits."""

    name: str
    in_order = False

    @abstractmethod
    def next(self) -> NDArray[Any]:
        """The next picture, stored numbers [height, width]; waits for it, and raises `CaptureEnd` at the end."""

    def close(self) -> None:
        """Let go of what it holds."""
        return


class GrowingFolder(Pictures):
    """Pictures that are put into a folder: each time the last in the order of their numbers, once it is
    another.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise SourceError(str(folder), "no folder", "a folder into which depth pictures are put")
        self.name, self._folder = str(folder), folder
        self._last: Path | None = None

    def next(self) -> NDArray[Any]:
        """See `Pictures.next`; where the folder goes, at once the end.

        A picture that is being written is looked at again for a second, then passed over.
        """
        until, since = time.monotonic() + PATIENCE_S, 0.0
        coming: Path | None = None
        while (began := time.monotonic()) < until:
            files = list_files(self._folder, with_suffix(*PICTURE_SUFFIXES))
            if not files and not self._folder.is_dir():
                raise CaptureEnd(self.name, "no folder any more", "a folder that grows")
            if coming is None and files and files[-1] != self._last:
                coming, since = files[-1], time.monotonic()
            if coming is not None:
                self._last = coming
                try:
                    return read_picture(coming)
                except SourceError:
                    if time.monotonic() > since + _UNFINISHED_S:
                        coming = None
            time.sleep(max(_LOOK_S, time.monotonic() - began))  # a large folder is not looked at all the time
        raise CaptureEnd(self.name, f"no new picture for {PATIENCE_S:g} s", "a folder that grows")


class PipedPictures(Pictures):
    """PNG pictures one behind the other, as ``ffmpeg -f image2pipe`` writes them."""

    name, in_order = "standard input", True

    def __init__(self, stream: IO[bytes] | None = None) -> None:
        self._stream = stream or standard_input()
        self._folder = TemporaryDirectory(prefix="touchfield-")

    def next(self) -> NDArray[Any]:
        data = bytearray(exactly(self._stream, len(_PNG)))
        if not data:
            raise CaptureEnd(self.name, "its end", "a picture")
        if data != _PNG:
            raise SourceError(self.name, f"{bytes(data)!r}", "PNG pictures one behind the other")
        kind = b""
        while kind != b"IEND":
            head = exactly(self._stream, 8)
            length, kind = struct.unpack(">I4s", head.ljust(8, b"\0"))
            if len(data) + length > _MOST_PNG_BYTES:
                raise SourceError(self.name, f"a picture of more than {_MOST_PNG_BYTES} bytes", "fewer")
            rest = exactly(self._stream, length + 4)
            if len(rest) < length + 4:
                raise CaptureEnd(self.name, "its end in the middle of a picture", "whole pictures")
            data += head + rest
        path = Path(self._folder.name) / "picture.png"
        path.write_bytes(data)
        return read_picture(path)

    def close(self) -> None:
        self._folder.cleanup()


class OpencvCamera(Pictures):
    """A depth camera that OpenCV opens: by number, or by whatever else `cv2.VideoCapture` takes."""

    def __init__(self, which: str) -> None:
        cv2 = import_extra("cv2", "a camera", "opencv-python-headless", "camera")
        self.name = f"camera:{which}"
        way = cv2.CAP_IMAGES if "%" in which else cv2.CAP_ANY  # a row of pictures is read with all its bits
        self._camera = cv2.VideoCapture(int(which) if which.isdigit() else which, way)
        if not self._camera.isOpened():
            raise SourceError(self.name, "no camera that OpenCV can open", "its number, such as camera:0")
        self._camera.set(cv2.CAP_PROP_CONVERT_RGB, 0)  # 16 bits as they are, where they are the main picture
        self._depth_map = cv2.CAP_OPENNI_DEPTH_MAP  # 0, which is the main picture where there is but one

    def next(self) -> NDArray[Any]:
        is_there = self._camera.grab()
        is_there, picture = self._camera.retrieve(None, self._depth_map) if is_there else (False, None)
        if not is_there:
            raise CaptureEnd(self.name, "no further picture", "a camera that is on")
        return np.asarray(picture)

    def close(self) -> None:
        self._camera.release()


class CapturedSequence(DepthSequence):
    """Depth of pictures as they are taken; `frame_count` is a bound. See the module.

    Raises `SourceError` if the first picture does not come, or is none of depth.
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
        self._news, self._waiting = Condition(), deque[Any](maxlen=None if pictures.in_order else 1)
        self._kept: dict[int, Float32s] = {}
        self._fault: SourceError | None = None
        self._is_closed = False
        Thread(target=self._run, daemon=True, name="touchfield-capture").start()
        first = self._newest()
        if first is None:
            raise self._fault or SourceError(self.name, f"no picture for {PATIENCE_S:g} s", "depth pictures")
        if first.ndim != 2 or first.dtype.itemsize < 2:
            raise SourceError(
                self.name, f"a picture {first.shape} of {first.dtype}", "16-bit (or float) grey depth"
            )
        height, width = first.shape
        camera = camera_of(self.name, options.intrinsics, folders, (width, height))
        scale = required_scale(
            self.name, options.depth_scale or camera.units_per_m or scale, first.dtype.kind == "f"
        )
        self._metres: Callable[[NDArray[Any]], Float32s] = DepthCode(scale)
        self.frame_count, self.width, self.height = MOST_FRAMES, width, height
        self.intrinsics: Intrinsics = camera.intrinsics
        self.rate_hz, self.notes = source_rate(options), camera.notes
        self._latest = self._kept[0] = self._metres(first)

    def depth_m(self, frame: int) -> Float32s:
        """See `DepthSequence.depth_m`: of a frame not asked for before, what there is to be seen now.

        Raises `CaptureEnd` where there are no more pictures.
        """
        if frame not in self._kept:
            picture = self._newest()
            if picture is None and self._fault is not None:
                raise self._fault
            if picture is not None:
                self._latest = self._metres(picture)
            self._kept[frame] = self._latest
            while len(self._kept) > _KEPT:
                del self._kept[next(iter(self._kept))]
        return self._kept[frame]

    def close(self) -> None:
        """Take no more pictures."""
        with self._news:
            self._is_closed = True
            self._news.notify_all()

    def _newest(self) -> NDArray[Any] | None:
        """The picture to be shown next; None where none is new, or there are no more."""
        with self._news:
            if self._pictures.in_order or not self._kept:
                self._news.wait_for(lambda: self._waiting or self._fault, PATIENCE_S)
            picture = self._waiting.popleft() if self._waiting else None
            self._news.notify_all()
        return picture

    def _run(self) -> None:
        try:
            while not self._is_closed:
                picture = self._pictures.next()
                with self._news:
                    if self._pictures.in_order:  # two wait, and then whoever takes them does
                        self._news.wait_for(lambda: len(self._waiting) < 2 or self._is_closed)
                    self._waiting.append(picture)
                    self._news.notify_all()
        except Exception as error:  # also of a driver: whoever waits is told
            with self._news:
                fault = SourceError(self.name, str(error) or type(error).__name__, "pictures")
                self._fault = error if isinstance(error, SourceError) else fault
                self._news.notify_all()
        finally:
            self._pictures.close()


def captured(source: object, options: SourceOptions) -> Scene | None:
    """The scene of ``camera:N``, ``watch:FOLDER`` or ``-``; None for any other source.

    Raises `SourceError` if no picture comes, `InvalidArgument` for options that need pictures still to come.
    """
    form, _, place = str(source).partition(":") if isinstance(source, str) else ("", "", "")
    if form not in ("camera", "watch", "-") or (form == "-") == bool(place):
        return None
    if options.reading != "camera" or options.segment is not None or options.poses is not None:
        found = "an option of pictures that are all there"
        raise InvalidArgument("--reading, --segment or --poses", found, "none of them", "Leave it out.")
    if form == "camera":
        sequence = CapturedSequence(OpencvCamera(place), options, (), 1000.0)
    elif form == "watch":
        sequence = CapturedSequence(GrowingFolder(Path(place)), options, (Path(place),))
    else:
        sequence = CapturedSequence(PipedPictures(), options)
    if options.world == "causal":
        return FusedScene(sequence, "causal")
    scene = DepthScene(sequence, frame="camera")
    scene.notes = (
        *scene.notes,
        "Each picture is felt alone; --world causal fuses those of a camera that stands.",
    )
    return scene
