"""Options by which a user says how a source is read, beyond its path, such as its depth unit or its frame
rate."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from touchfield.errors import InvalidArgument, require_kinds, require_one_of, require_positive
from touchfield.options import option


@dataclass(frozen=True)
class SourceOptions:
    """Options of the source readers; each kind reads those that apply to it.

    Parameters
    ----------
    kind : str or None; Name of a source kind; None to recognise it.
    depth_scale : float or None; Stored depth units in one metre (1000 for millimetres, 5000 for TUM).
    intrinsics : str or None; "fx,fy,cx,cy" in pixels, or the path of an intrinsics file.
    poses : str or None; Depth sequences: path of the camera poses (`touchfield.sources.depth.frame_poses`);
        None to search for them.
    pose_form : str or None; Depth sequences: how poses are read if not as scene from camera in the axes of
        the pictures; words of `touchfield.sources.depth.pose_form.FORMS`, separated by commas.
    depth_encoding : str or None; Bits of stored depth: "plain", or "rotated" by 3 (SUN3D, APC); None for that
        of the layout.
    topic : str or None; Bags: the topic of the depth images; None for the one with the most.
    frame : str; Depth sequences: "world" uses the camera poses, if there are any, so that the scene of a
        moving camera is static; with "camera" the workspace moves with the camera.
    world : str; Depth sequences in world coordinates: "fused" (one world from all frames), "causal" (one
        world from the frames so far) or "frames" (each frame alone, as in the paper).
    reading : str; Depth maps: "camera" (back-projected with perspective; the surface is a wall with a
        thickness) or "height" (the height map of the paper: everything behind the surface is solid).
    shell : str; Open meshes and point clouds: "one" sided (the wall lies behind the faces), "two" sided, or
        "auto".
    normals : str; Point clouds: which side the surface faces: that of the normals of the file ("given"),
        towards the "scanner", "up", "outward", "inward", or "auto", the first of them that the file allows.
    holes : str; Meshes: close the "small" holes, all holes ("close") or none ("leave").
    cell_size_m : float or None; Height maps: metres between neighbouring samples.
    height_scale : float or None; Height maps: metres of one stored unit.
    exaggeration : float; Height maps: factor on heights; 1 keeps the true proportions.
    unit_m : float or None; Meshes and point clouds: metres of one unit of the coordinates.
    rate_hz : float or None; Frames a second of the medium. A formula or a simulation is evaluated at this
        rate; a depth sequence of known rate is interpolated in time. If neither the source nor
        `source_rate_hz` gives the rate of the source, `rate_hz` is also taken as the rate of the source.
    seconds : float or None; Simulations: duration.
    source_rate_hz : float or None; Frames a second of the source, if the source does not state it.
    interpolation : str; Depth sequences: how depth between two frames is computed, "linear" (as in the paper)
        or "nearest" (the frame nearest in time).
    animation : str or None; Animated models: name or number of the animation; None for the first.
    relative_depth : str or None; Pictures and videos: path of the relative depth.
    near_m, far_m : float or None; Relative depth: metres of the nearest and of the farthest value.
    segment : str or None; Depth sequences in the object representation: segmentation rule (see
        `touchfield.sources.depth.segmentation`); None for the default rule.
    baseline_m, disparity_offset_px : float or None; Disparity maps: depth = fx * baseline_m / (disparity +
        disparity_offset_px).
    allow_outside : bool; Whether a model or scene file may name files outside its own folder. Never read from
        a ``.touch`` file.
    """

    kind: str | None = None
    depth_scale: float | None = option(None, "Stored depth units in a metre.")
    intrinsics: str | None = option(None, "Camera: fx,fy,cx,cy in pixels, or a file.")
    poses: str | None = option(
        None, "Depth sequences: camera poses, a file or folder; found if they are next to the pictures."
    )
    pose_form: str | None = option(
        None,
        "Depth sequences: how poses are read: inverted, opengl, ros, mirrored, wxyz, mm, cm, reversed or "
        "alphabetical; several with commas.",
    )
    depth_encoding: str | None = option(
        None, "Bits of stored depth: plain, or rotated (by 3, as in SUN3D and APC)."
    )
    topic: str | None = option(None, "Bags: topic of the depth images.")
    frame: str = option("world", "Depth sequences: world (poses are used) or camera.")
    world: str = option(
        "fused", "Depth sequences: fused (one of all frames), causal (of those so far), frames."
    )
    reading: str = option("camera", "Depth maps: camera (metric, a wall) or height (solid, as in the paper).")
    shell: str = option("auto", "Open meshes and point clouds: one or two sided.")
    normals: str = option(
        "auto", "Point clouds: where the surface faces: given, scanner, up, outward or inward."
    )
    holes: str = option(
        "small", "Holes of meshes: close, leave, or small (close those below 5 % of the area)."
    )
    cell_size_m: float | None = option(None, "Height maps: metres between samples.")
    height_scale: float | None = option(None, "Height maps: metres of one stored unit.")
    exaggeration: float = option(1.0, "Height maps: factor on heights.")
    unit_m: float | None = option(None, "Meshes and point clouds: metres of one unit.")
    rate_hz: float | None = option(
        None, "Frames a second of the medium; depth frames are interpolated in time."
    )
    seconds: float | None = option(None, "Simulations: their duration.")
    source_rate_hz: float | None = option(None, "Frames a second of the source, where it does not say.")
    interpolation: str = option("linear", "Between depth frames: linear or nearest.")
    animation: str | None = option(None, "Animated models: name or number of the animation.")
    relative_depth: str | None = option(None, "Pictures and videos: the relative depth of each.")
    near_m: float | None = option(None, "Relative depth: metres of its nearest value.")
    far_m: float | None = option(None, "Relative depth: metres of its farthest value.")
    segment: str | None = option(None, "Depth sequences as objects: step=0.03,least=0.2%,at-most=16.")
    baseline_m: float | None = option(None, "Disparity maps: distance between the cameras.")
    disparity_offset_px: float | None = option(None, "Disparity maps: offset of the principal points.")
    allow_outside: bool = option(False, "Models and scene files may name files outside their own folder.")

    def __post_init__(self) -> None:
        require_kinds(
            self,
            frame=("world", "camera"),
            world=("fused", "causal", "frames"),
            reading=("camera", "height"),
            shell=("auto", "one", "two"),
            normals=("auto", "given", "scanner", "up", "outward", "inward"),
            holes=("small", "close", "leave"),
            interpolation=("linear", "nearest"),
        )
        if self.depth_encoding is not None:
            require_one_of("depth_encoding", self.depth_encoding, ("plain", "rotated"))
        if self.poses is not None and self.frame == "camera":
            raise InvalidArgument("poses", "poses with frame camera", "frame world, which uses them")
        if self.pose_form is not None and self.frame == "camera":
            raise InvalidArgument(
                "pose_form", "a form of poses with frame camera", "frame world, which uses them"
            )
        positive = (
            "depth_scale", "cell_size_m", "height_scale", "exaggeration", "unit_m", "rate_hz", "seconds",
            "source_rate_hz", "near_m", "far_m", "baseline_m",
        )  # fmt: skip
        require_positive(
            **{name: getattr(self, name) for name in positive if getattr(self, name) is not None}
        )


class WatchedOptions:
    """Proxy of `SourceOptions` that records which options were read."""

    def __init__(self, options: SourceOptions) -> None:
        self._options = options
        self._read = {"kind", "allow_outside"}

    def __getattr__(self, name: str) -> Any:
        self._read.add(name)
        return getattr(self._options, name)

    def unread(self) -> list[str]:
        """Return the names of the options that differ from their default and were not read."""
        defaults = SourceOptions()
        changed = [
            f.name for f in fields(defaults) if getattr(self._options, f.name) != getattr(defaults, f.name)
        ]
        return [name for name in changed if name not in self._read]
