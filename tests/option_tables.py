"""A non-default value for every option of every command, and where the task receives it.

`EXPECTED[command]` has one `Case` for each option; a new option needs a new one. Paths are those of `flatten`
in `tests/cli/test_every_option.py`: the name of the called function, its parameters, and fields within them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from touchfield.cli.citations import cited_commands, sources_of

MISSING: Final = "<missing>"
CALLED: Final = "<called>"
STUB: Final = "<stub>"


@dataclass(frozen=True)
class Case:
    """An option with a value, and the only leaves of the calls that change: end of the path -> new value.

    `beside` are further arguments that the option needs; the default run has them, too. {tmp} in a text
    stands for the folder of the test.
    """

    text: str | None
    leaves: dict[str, Any] = field(default_factory=dict)
    beside: str = ""
    refused: str = ""
    """Message of the error, if the option is incompatible with the other arguments of the command."""
    printed: str = ""
    """Text printed only by the run with the option, if no function receives it."""


def case(text: str | None, leaf: str, value: Any, beside: str = "", **more: Any) -> Case:
    return Case(text, {leaf: value, **more}, beside)


def _scene(*, without: tuple[str, ...] = ()) -> dict[str, Case]:
    cases = {
        "device": ("novint-falcon", "device", "novint-falcon"),
        "nw": ("5", "nw", 5),
        "frames": ("3:7", ".frames", (3, 7)),
        "mapping": ("0.25", "mapping", "0.25"),
        "stiffness-n-per-m": ("321", "stiffness_n_per_m", 321.0),
        "thickness-m": ("0.012", "thickness_m", 0.012),
        "nominal": (None, ".nw", None),
        "representation": ("voxel", "representation", "voxel"),
        "fit-frames": ("2:", "fit_frames", (2, None)),
        "oversample": ("3", "oversample", 3),
        "pool": ("mean", "pool", "mean"),
        "cutoff": ("literal", "cutoff", "literal"),
        "law": ("proximity", ".law", "proximity"),
        "thin": ("keep", ".thin", "keep"),
        "band-m": ("0.003", "band_m", 0.003),
        "surface-damping-n-s-per-m": ("1.5", "surface_damping_n_s_per_m", 1.5),
        "as": ("stl", "source.kind", "stl"),
        "depth-scale": ("1234", "source.depth_scale", 1234.0),
        "intrinsics": ("60,61,32,24", "source.intrinsics", "60,61,32,24"),
        "poses": ("poses.txt", "source.poses", "poses.txt"),
        "pose-form": ("wxyz,mm", "source.pose_form", "wxyz,mm"),
        "topic": ("/depth", "source.topic", "/depth"),
        "depth-encoding": ("rotated", "source.depth_encoding", "rotated"),
        "frame": ("camera", "source.frame", "camera"),
        "world": ("causal", "source.world", "causal"),
        "reading": ("height", "source.reading", "height"),
        "shell": ("two", "source.shell", "two"),
        "holes": ("leave", "source.holes", "leave"),
        "normals": ("up", "source.normals", "up"),
        "cell-size-m": ("0.7", "source.cell_size_m", 0.7),
        "height-scale": ("0.3", "source.height_scale", 0.3),
        "exaggeration": ("2.5", "source.exaggeration", 2.5),
        "unit-m": ("0.01", "source.unit_m", 0.01),
        "rate-hz": ("29", "source.rate_hz", 29.0),
        "seconds": ("1.75", "source.seconds", 1.75),
        "source-rate-hz": ("11", "source.source_rate_hz", 11.0),
        "interpolation": ("nearest", "source.interpolation", "nearest"),
        "animation": ("walk", "source.animation", "walk"),
        "relative-depth": ("rel.png", "source.relative_depth", "rel.png"),
        "near-m": ("0.6", "source.near_m", 0.6),
        "far-m": ("6.5", "source.far_m", 6.5),
        "segment": ("rule", "source.segment", "rule"),
        "baseline-m": ("0.12", "source.baseline_m", 0.12),
        "disparity-offset-px": ("3.5", "source.disparity_offset_px", 3.5),
        "allow-outside": (None, "source.allow_outside", True),
    }
    return {name: case(*values) for name, values in cases.items() if name not in without}


def _coder(*, own_k: bool = False) -> dict[str, Case]:
    paper = "--coder paper"
    return {
        "k": case("0.2", "touch.k", 0.2),
        "f0-n": case("0.07", "touch.f0_n", 0.07),
        "mode": case("mask-direction", "touch.mode", "mask-direction"),
        "coder": case("paper", "spec.coder", "paper"),
        "segment-frames": case("17", "touch.segment_frames", 17),
        "direction-jnd-deg": case("21", "touch.direction_jnd_deg", 21.0, "--mode mask-direction"),
        "step-n": case("0.03", "touch.step_n", 0.03, "--mode nmse"),
        "support": case("exact", "touch.support", "exact"),
        "effort": case("fast", "touch.effort", "fast"),
        "masking": case("0.3", "touch.masking", 0.3),
        "body-site": case("palm", "touch.masking_radius_m", 0.01, "--masking 0.3"),
        "profile": Case(
            "grip=ball", {"touch.k": 0.08, "touch.f0_n": 0.04, "touch.k_by_force": ((0.5, 0.08),)}
        ),
        "lossless-quantised": case(None, "touch.mode", "lossless"),
        "interframe": case("on", "touch.interframe", "on"),
        "nq": case("5", "paper.nq", 5, paper),
        "directions": case("ico3", "paper.directions", "ico3", paper),
        "amplitude": case("weber", "paper.amplitude", "weber", paper),
        "deadband": case("none", "paper.deadband", "none", paper),
        "stage": case("dct", "paper.stage", "dct", paper),
    }


_COEFFICIENTS: Final = {
    "friction": case("0.35", "spec.friction", 0.35),
    "damping-n-s-per-m": case("2.5", "spec.damping_n_s_per_m", 2.5),
}
_ALLOW_EMPTY: Final = {"allow-empty": case(None, ".allow_empty", True)}
_BESIDE: Final = {
    "vibration": case("gain=0.1,frequency=150", "spec.vibration", "gain=0.1,frequency=150"),
    **_COEFFICIENTS,
}


def _filters() -> dict[str, Case]:
    texts = {
        "gaussian": "3mm", "fir": "1/2/1", "lowpass": "pitch=35mm", "shading": "2mm",
        "perona-malik": "steps=10,kappa=0.3", "multiresolution": "stages=2", "texture": "salt-pepper:seed=1",
    }  # fmt: skip
    return {name: case(text, "spec.filters", ((name, text),)) for name, text in texts.items()}


def _address(port: str) -> dict[str, Case]:
    return {
        "host": case("localhost", "access.host", "localhost"),
        "port": case(port, "access.port", int(port)),
        "token": case("a-long-word", "access.token", "a-long-word"),
        "open": case(None, "access.is_open", True),
        "cors": case("https://example.org", "access.origins", ("https://example.org",)),
    }


_WORKERS: Final = case("processes:3", "executor_of.text", "processes:3")
_DEVICE_COMPUTE: Final = case("auto", "computing.where", "auto")
_JSON: Final = case(None, "show.as_json", True)
_DRAWN: Final = "{tmp}/picture.png"

ARGUMENTS: Final = {
    "encode": "scene.stl {tmp}/out.touch",
    "filter": "scene.stl {tmp}/out.touch --friction 0.2",
    "field": "scene.stl {tmp}/out.npz",
    "plan": "scene.stl --budget 60kB",
    "decode": "in.touch {tmp}/out.npz",
    "export": "in.touch {tmp}/out.hjif",
    "import": "in.hjif {tmp}/out.touch",
    "map": "in.geojson {tmp}/out.touch",
    "watch": "movie.mp4 --out {tmp}/out.mp4",
    "edit": "in.touch {tmp}/out.touch --operator erase",
    "splice": "one.touch two.touch {tmp}/out.touch",
    "resample": "in.touch {tmp}/out.touch",
    "lod": "in.touch {tmp}/levels",
    "partition": "in.touch",
    "texture": "one.wav two.wav --out {tmp}/out.json --speed-m-s 0.05 --force-n 1",
    "deform": "in.touch model.glb",
    "info": "in.touch",
    "view": "in.touch",
    "compare": "scene.stl {tmp}/in.touch",
    "play": "{tmp}/in.touch",
    "guide": "folder",
    "serve": "streams",
    "live": "scene.stl",
    "mux": "movie.mp4 in.touch {tmp}/out.mp4",
    "demux": "movie.mp4 {tmp}/out.touch",
    "measure": "scene.stl",
    "reduce": "in.touch {tmp}/out.touch",
    "index": "folder",
    "search": "folder like.touch",
    "similar": "one.touch two.touch",
    "study": "run design.toml {tmp}/results --observer threshold=2",
    "correlate": "video.mp4 in.touch",
    "points": "5 in.touch",
    "demo": "{tmp}/demo",
    "devices": "",
    "sources": "",
    "data": "",
    "doctor": "",
    "warmup": "",
}
"""Arguments of each command, and its mandatory options."""

EXPECTED: Final[dict[str, dict[str, Case]]] = {
    "encode": {
        "report": Case(None, {"compare_prepared": CALLED}),
        "plot": case(
            _DRAWN,
            "compare_prepared().draw.0",
            _DRAWN,
            **{"compare_prepared": CALLED, "compare_prepared().draw": CALLED},
        ),
        "workers": _WORKERS,
        "device-compute": _DEVICE_COMPUTE,
        **_scene(),
        **_ALLOW_EMPTY,
        **_BESIDE,
        **_coder(),
        "target-bytes": case("5000", "target.bytes", 5000, encode=MISSING, encode_to_target=CALLED),
        "target-nmse-db": case(
            "-21",
            "target.nmse_db",
            -21.0,
            encode=MISSING,
            encode_to_target=CALLED,
            **{"encode_to_target.spec.touch.mode": "nmse"},
        ),
    },
    "filter": {
        "report": Case(None, {"filter_report": CALLED}),
        "plot": case(_DRAWN, "draw_filtered.path", _DRAWN, draw_filtered=CALLED),
        "workers": _WORKERS,
        **_filters(),
        **_scene(),
        **_ALLOW_EMPTY,
        **_BESIDE,
        **_coder(),
    },
    "field": {
        "preview": case(_DRAWN, "draw_preview.path", _DRAWN, draw_preview=CALLED),
        "device-compute": _DEVICE_COMPUTE,
        **_scene(),
        **_ALLOW_EMPTY,
    },
    "plan": {
        **_scene(without=("nw", "nominal")),
        "nw": Case("5", {"spec.nw": 5, "search.nw": (3, 4, 5)}),
        "nominal": Case(None, refused="--nominal does not go with plan"),
        "budget": case("70kB", "budget.bytes", 70000),
        "k": case("0.2", "search.k", (0.2,)),
        "effort": case("default", "touch.effort", "default"),
        "plot": case(_DRAWN, "plan().draw.0", _DRAWN, **{"plan().draw": CALLED}),
        "workers": _WORKERS,
    },
    "decode": {},
    "export": {
        "device": case("tshirt-32x32", "export.device_name", "tshirt-32x32"),
        "trajectory": case("hand.csv", "export.trajectory", "hand.csv"),
        "panel": case("back", "export.panel", "back"),
        "full-scale-n": case("2.5", "export.full_scale_n", 2.5),
        "source": case("scene.stl", "export.against", "scene.stl"),
    },
    "map": {
        "device": case("dotpad", "spec.device", "dotpad"),
        "box": case("1,2,3,4.5", "spec.box", (1.0, 2.0, 3.0, 4.5)),
        "level": case("-1", "spec.level", "-1"),
        "language": case("de", "spec.language", "de"),
        "zooms": case("3", "spec.zooms", 3),
        "relief": case("heights.tif", "spec.relief", "heights.tif"),
        "interval-m": case("2.5", "spec.interval_m", 2.5, "--relief heights.tif"),
        "no-labels": case(None, "spec.has_labels", False),
        "svg": case("{tmp}/out.svg", "make_map.svg", "{tmp}/out.svg"),
        "stl": case("{tmp}/out.stl", "make_map.stl", "{tmp}/out.stl"),
        "plot": Case(_DRAWN, {"make_map().draw": CALLED}),
    },
    "watch": {
        "out": case("{tmp}/new.mkv", "watch.out", "{tmp}/new.mkv"),
        "device": case("tactile-vest-8x8", "spec.device", "tactile-vest-8x8"),
        "only": case("sound", "spec.only", "sound"),
        "depth": case("depth.mkv", "spec.depth", "depth.mkv"),
        "plot": case(_DRAWN, "watch.plot", _DRAWN),
    },
    "import": {
        "rate-hz": case("75", "import_effect.rate_hz", 75.0),
        "force-max-n": case("2.25", "import_effect.force_max_n", 2.25),
    },
    "edit": {
        "operator": Case("gain:2", {"edit.operators": ("erase", "gain:2")}),
        "region": case("force:1..2", "edit.region", "force:1..2"),
        "feather": case("2mm", "edit.feather_m", 0.002),
        "frames": case("2:5", "edit.frames", (2, 5)),
        # what it does: tests/tasks/test_timeline.py
        "timeline": Case("edits.json", refused="--operator has no effect with --timeline"),
        **_coder(),
    },
    "splice": {
        "fade-s": case("0.5", "splice.fade_s", 0.5),
        "kernel": case("box", "splice.kernel", "box"),
        **_COEFFICIENTS,
        **_coder(),
    },
    "resample": {
        "nw": case("5", "resample_file.lattice", (5, None, None)),
        "shape": case("8,9,10", "resample_file.lattice", (None, (8, 9, 10), None)),
        "spacing": case("1.5mm", "resample_file.lattice", (None, None, 0.0015)),
        "rate-hz": case("12", "resample_file.rate_hz", 12.0),
        "kernel": case("sinc", "resample_file.kernel", "sinc"),
        **_coder(),
    },
    "lod": {
        "levels": case("2", "levels_of_detail.levels", 2),
        "max-bytes": case("9000", "levels_of_detail.max_bytes", 9000),
        **_coder(),
    },
    "partition": {
        "depth": case("3", "partition_workspace.device_shape", (8, 4, 2)),
        "penalty-bits": case("250", "partition_workspace.penalty_bits", 250.0),
        "quantiser": case("uniform:0.1", "partition_workspace.quantiser", "uniform:0.1"),
    },
    "texture": {
        "out": case("{tmp}/new.json", "write_table.path", "{tmp}/new.json", "--name oak"),
        "speed-m-s": case("0.1,0.2", "texture_of_files.speeds_m_s", (0.1, 0.2)),
        "force-n": case("2,3", "texture_of_files.forces_n", (2.0, 3.0)),
        "name": case("oak", "texture_of_files.name", "oak"),
        "friction": case("0.4", "texture_of_files.friction", 0.4),
        "full-scale-m-s2": case("20", "texture_of_files.full_scale_m_s2", 20.0),
        "into": case(
            "{tmp}/in.touch",
            "store_materials.stream",
            "{tmp}/in.touch",
            store_materials=CALLED,
            write_table=MISSING,
        ),
        "plot": case(_DRAWN, "draw_textures.path", _DRAWN, draw_textures=CALLED),
    },
    "deform": {
        "out": case("{tmp}/bent.npz", "tracks_of.out", "{tmp}/bent.npz"),
        "controls": case("9", "tracks_of.controls", 9),
        "yield-m-per-n": case("0.002", "tracks_of.compliance_m_per_n", 0.002),
        "relax-s": case("0.1", "tracks_of.relax_s", 0.1, "--yield-m-per-n 0.002"),
        "frames": case("4:9", "motion.frames", (4, 9)),
        "animation": case("walk", "motion.animation", "walk"),
        "rest-frame": case("6", "motion.rest_frame", 6),
        "rate-hz": case("45", "motion.rate_hz", 45.0),
    },
    "info": {"voxels": Case(None, {"open_stream().supported_voxels": CALLED})},
    "view": {
        "source": case("scene.stl", "view.against", "scene.stl"),
        "device": case("phantom-omni", "view.devices", ("phantom-omni",)),
        "out": Case(
            "{tmp}/page.html",
            {"view().save": CALLED, "view().save.0": "{tmp}/page.html", "view().open.0": STUB},
        ),
        "no-open": Case(None, {"view().open": MISSING}, "--out {tmp}/page.html"),
        "page": case("field", "view.page", "field"),
        "rerun": Case(
            None,
            {
                "view": MISSING,
                "view().save": MISSING,
                "view().open": MISSING,
                "view_in_rerun": CALLED,
                "view_in_rerun.stream": "in.touch",
                "view_in_rerun.out": "{tmp}/scene.rrd",
            },
            "--out {tmp}/scene.rrd",
        ),
        "log": case("{tmp}/hand.csv", "view_in_rerun.log", "{tmp}/hand.csv", "--rerun"),
    },
    "compare": {
        "picture": case(_DRAWN, "compare().draw.0", _DRAWN),
        "no-picture": Case(None, {"compare().draw": MISSING}),
        "frame": case("3", "compare.frame", 3),
        "k": case("0.3", "compare.k", 0.3),
        "f0-n": case("0.07", "compare.f0_n", 0.07),
        "allow-outside": case(None, "compare.allow_outside", True),
    },
    "play": {
        "log": Case(
            "{tmp}/log.csv",
            {"play().write_log": CALLED, "play().write_log.0": "{tmp}/log.csv", "spec.is_logged": True},
        ),
        "plot": Case(
            _DRAWN,
            {"play().draw": CALLED, "play().draw.0": _DRAWN, "spec.is_logged": True, "spec.is_drawn": True},
        ),
        "check": Case(None, {"play": MISSING, "check_play": CALLED, "check_play.path": "{tmp}/in.touch"}),
        "bridge": Case(None, {"Bridge": CALLED, "Bridge.stream": "{tmp}/in.touch", "play.on_player": STUB}),
        "device": case("sim:spring", "spec.device", "sim:spring"),
        "wait": case("5s", "spec.wait", "5s"),
        "settings": case("gravity=off", "spec.settings", "gravity=off"),
        "profile": case("novint-falcon", "spec.profile", "novint-falcon"),
        "trajectory": case("hand.csv", "spec.trajectory", "hand.csv"),
        "seconds": case("2.5", "spec.seconds", 2.5),
        "start-s": case("1.5", "spec.start_s", 1.5),
        "speed": case("0.5", "spec.speed", 0.5),
        "loop": case(None, "spec.loop", True),
        "panel": case("back", "spec.panel", "back", "--device pins:h:9"),
        "offline": case(None, "spec.offline", True),
        "trace": case("hand.csv", "spec.trace", "hand.csv"),
        "find": case("Mill Lane", "spec.find", "Mill Lane"),
        "pans": case("in,left", "spec.pans", "in,left"),
        "coarse": case("ws://here/coarse/live", "spec.coarse", "ws://here/coarse/live"),
        "rate-hz": case("500", "render.rate_hz", 500.0),
        "friction": case("0.35", "render.friction", 0.35),
        "damping-n-s-per-m": case("2.5", "render.damping_n_s_per_m", 2.5),
        "coupling-n-per-m": case("700", "render.coupling_n_per_m", 700.0),
        "passivity": case(None, "render.passivity", True),
        "scale": case("1.5", "render.scale", 1.5),
        "force-scale": case("0.75", "render.force_scale", 0.75),
        "peak-n": case("2.75", "render.peak_n", 2.75),
        "continuous-n": case("0.6", "render.continuous_n", 0.6),
        "slew-n-per-s": case("99", "render.slew_n_per_s", 99.0),
        "render": case("field", "render.render", "field"),
        "wall-n-per-m": case("650", "render.wall_n_per_m", 650.0),
        "peak-nm": case("0.04", "render.peak_nm", 0.04),
        "continuous-nm": case("0.03", "render.continuous_nm", 0.03),
        "slew-nm-per-s": case("5", "render.slew_nm_per_s", 5.0),
        "up": case("y", "render.up", "y"),
        "axes": case("-x,y,z", "render.axes", "-x,y,z"),
        "clutch-mm": case("1,-2,3", "render.clutch_m", (0.001, -0.002, 0.003)),
        "gravity-n": case("0,-1,0.5", "render.gravity_n", (0.0, -1.0, 0.5)),
        "no-blend": case(None, "render.blend", False),
        "tool": Case(
            "sphere:0.004", {"play.spec.render.tool": MISSING, "render.tool.name": "sphere of 4 mm"}
        ),
        "materials": Case(
            "oak.json",
            {"read_materials": CALLED, "read_materials.path": "oak.json", "render.materials": STUB},
        ),
        "deformation": Case(
            "bent.npz",
            {"read_deformation": CALLED, "read_deformation.path": "bent.npz", "render.deformation": STUB},
        ),
    },
    "guide": {
        "log": case("{tmp}/log.csv", "guide.log", "{tmp}/log.csv"),
        "plot": Case(
            "{tmp}/guide.png",
            {"Rows().draw": CALLED, "Rows().draw.0": "{tmp}/guide.png", "guide.on_shown": STUB},
        ),
        "device": case("bhaptics", "run.device", "bhaptics"),
        "profile": case("tactsuit-x16", "run.profile", "tactsuit-x16"),
        "wait": case("5s", "run.wait", "5s"),
        "seconds": case("2.5", "run.seconds", 2.5),
        "offline": case(None, "run.offline", True),
        "warn-m": case("1.5", "guide.warn_m", 1.5),
        "contact-s": case("3", "guide.contact_s", 3.0),
        "step-m": case("0.1", "guide.step_m", 0.1),
        "head-m": case("1.9", "guide.head_m", 1.9),
        "camera-height-m": case("1.3", "guide.camera_height_m", 1.3),
        "pitch-deg": case("20", "guide.pitch_deg", 20.0),
        "timeout-s": case("0.3", "guide.timeout_s", 0.3),
        "memory-s": case("5", "guide.memory_s", 5.0),
        "first-column": case("right", "guide.first_column", "right"),
        "as": case("tum", "options.kind", "tum"),
        "depth-scale": case("1234", "options.depth_scale", 1234.0),
        "intrinsics": case("60,61,32,24", "options.intrinsics", "60,61,32,24"),
        "poses": case("poses.txt", "options.poses", "poses.txt"),
        "pose-form": case("wxyz,mm", "options.pose_form", "wxyz,mm"),
        "depth-encoding": case("rotated", "options.depth_encoding", "rotated"),
        "topic": case("/depth", "options.topic", "/depth"),
        "source-rate-hz": case("11", "options.source_rate_hz", 11.0),
    },
    "serve": _address("8099"),
    "live": {
        **_address("8098"),
        **_scene(),
        "segment-s": case("0.5", "broadcast.spec.segment_s", 0.5),
        "loop": case(None, "broadcast.spec.loop", True),
        "udp": Case(
            "127.0.0.1:9", {"UdpSender": CALLED, "UdpSender.text": "127.0.0.1:9", "broadcast.send": MISSING}
        ),
        "coarse": Case(None, {"coarse_layer": CALLED, "LiveServer.coarse": STUB, "broadcast.coarse": STUB}),
        "on-air-s": case("2.5", "broadcast.spec.seconds", 2.5),
    },
    "mux": {"at-s": case("12.5", "mux.at_s", 12.5), "sidecar": case(None, "mux.has_sidecar", True)},
    "demux": {"track": case("sound", "demux.track", "sound")},
    "measure": {
        **_scene(without=("device",)),
        "device": case("tshirt-32x32", "spec.devices", ("tshirt-32x32",)),
        "reference": case("novint-falcon", "encode.device", "novint-falcon"),
        "no-limits": case(None, "spec.limits", False),
        "plot": Case(_DRAWN, {"measure_medium().draw": CALLED, "measure_medium().draw.0": _DRAWN}),
        "quantiser": case("uniform:0.1", "spec.quantiser", "uniform:0.1"),
        "over": case("object", "spec.over", "object"),
        "estimator": case("miller-madow", "spec.estimator", "miller-madow"),
        "density": case("4", "spec.density", 4.0, "--device tshirt-32x32"),
    },
    "reduce": {
        **{name: own for name, own in _coder().items() if name != "coder"},
        "coder": case("paper", "coder.coder", "paper"),
        "cull": case("{tmp}/shell.touch", "reduce_medium.cull", "{tmp}/shell.touch"),
        "plot": Case(_DRAWN, {"reduce_medium().draw": CALLED, "reduce_medium().draw.0": _DRAWN}),
        "modes": case("bricks", "spec.modes", "bricks"),
        "rank": case("7", "spec.rank", 7),
        "nmse-db": case("-22", "spec.nmse_db", -22.0),
        "push-n": case("1.25", "spec.push_n", 1.25),
        "mass-kg": case("0.3", "spec.mass_kg", 0.3),
        "speed-m-s": case("0.4", "spec.speed_m_s", 0.4),
        "device": case("novint-falcon", "spec.device", "novint-falcon"),
        "trace": case("log.csv", "spec.trace", "log.csv"),
    },
    "index": {"index": case("{tmp}/i.npz", "index_folder.path", "{tmp}/i.npz"), "workers": _WORKERS},
    "search": {
        "count": case("3", "search.count", 3),
        "any-pose": Case(
            None, {f"search.weights.{part}": 0.0 for part in ("directions", "support", "level_entropy")}
        ),
        "weight": case("amplitude=2", "search.weights.amplitude", 2.0),
        "index": case("i.npz", "search.path", "i.npz"),
    },
    "similar": {
        **_scene(),
        "quantiser": case("uniform:0.1", "similar.quantiser", "uniform:0.1"),
        "over": case("voxel", "similar.over", "voxel"),
        "looks": case("5", "similar.frames", 5),
    },
    "study": {
        "participant": case("07", "run_session.spec.participant", "07"),
        "device": Case("sim", refused="--device, --observer: found both"),
        "wait": Case("1min", refused="--wait: found no device to wait for; expected --device"),
        "observer": case("threshold=3", "run_session.spec.observer", "threshold=3"),
        "runs": Case("20", refused="--runs is only for study power, not for study run"),
        "plot": Case("fits.png", refused="--plot is only for study analyse, not for study run"),
    },
    "correlate": {
        "looks": case("5", "correlate.frames", 5),
        "reading": case("first", "correlate.reading", "first"),
        "intrinsics": case("60,61,32,24", "correlate.intrinsics", (60.0, 61.0, 32.0, 24.0)),
        "source-rate-hz": case("24", "correlate.source_rate_hz", 24.0),
    },
    "points": {
        **_coder(),
        "modes": case("3", "fewest_points.modes", 3),
        "next": Case(None, {"fewest_points": MISSING, "next_points": CALLED, "next_points.count": 5}),
        "measured": case("seen.csv", "next_points.measured", "seen.csv", "--next"),
        "plot": Case(_DRAWN, {"fewest_points().draw": CALLED, "fewest_points().draw.0": _DRAWN}),
    },
    "demo": {},
    "devices": {
        "verbose": Case(None, printed="  force_max_n: "),
        "connected": Case(None, printed="touchfield doctor --device haply"),
    },
    "sources": {},
    "data": {},
    "doctor": {
        "device": case("haply", "examine.name", "haply"),
        "delay": case(None, "examine.measures_delay", True),
    },
    "warmup": {},
}

for _command in set(ARGUMENTS) - {"serve", "warmup"}:
    if _command in cited_commands():
        EXPECTED[_command]["cite"] = case(None, "show.sources", sources_of(_command))
    EXPECTED[_command]["json"] = case(None, "run_demo.as_json", True) if _command == "demo" else _JSON
