"""Formats that strangers send: small valid inputs of each, the function behind the command that reads it, and
the mutators of its files.

The inputs are those of `tests/source_corpus.py` and other makers of the tests, with fewer points.
"""

from __future__ import annotations

import json
import random
import struct
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path.extend(
    str(Path(__file__).resolve().parents[1] / folder) for folder in ("tests", "tests/network", "conformance")
)
import layout_makers as layouts
import mutation as text
import mutation_binary as binary
import source_corpus as corpus
from mutation import Mutator, bit_fields, columns, header_until, json_tree, one_of, raw, xml_tree
from touchfield.errors import InvalidArgument, naming_file

ROOT: Final = Path(__file__).resolve().parents[1]
Write = Callable[[Path], Path]
Read = Callable[[Path, Path, dict[str, Any]], object]
"""Reads an input: its path, a file to write, and the options of the source."""


@dataclass(frozen=True)
class Seed:
    """A valid input.

    write : called with a folder that does not exist; returns the path to read.
    options : fields of `SourceOptions`; ``device`` is that of the encoding.
    """

    write: Write
    options: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Format:
    """A format, its reader, its inputs and the endings of the files to damage (all if there are none).

    `mutate` replaces the mutators by ending; `free_s` and `free_mib` are the processor time, seconds, and the
    memory that any file may take.
    """

    name: str
    read: Read
    seeds: tuple[Seed, ...]
    endings: tuple[str, ...] = ()
    mutate: Mutator | None = None
    free_s: float = 3.0
    free_mib: int = 192

    def mutator(self, path: Path) -> Mutator:
        """Return the mutator of a file."""
        return self.mutate or mutator_of(path.name)

    def is_damaged(self, path: Path) -> bool:
        """Return True if a file may be damaged."""
        return not self.endings or path.suffix.lower() in self.endings


# -- readers -----------------------------------------------------------------------------------------------


def encode(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Prepare a source as `touchfield encode` does, and compute its first frame."""
    from touchfield.pipeline.preparation import prepare
    from touchfield.pipeline.spec import EncodeSpec
    from touchfield.sources.options import SourceOptions

    source = {key: value for key, value in options.items() if key != "device"}
    device = {"device": options["device"]} if "device" in options else {"nw": 4}
    spec = EncodeSpec(source=SourceOptions(**source), **device)
    return prepare(path, spec).medium[0]


def read_effect(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Read an effect as `touchfield import` does, and make its medium; nothing is encoded."""
    from touchfield.exchange.ahap import read_ahap
    from touchfield.exchange.haptic_read import read_haptic
    from touchfield.exchange.hjif_import import read_hjif_array
    from touchfield.exchange.symbolic import effect_device, effect_medium
    from touchfield.exchange.tact_read import read_tact
    from touchfield.filters.device_spec import device_grid

    readers = {".ahap": read_ahap, ".haptic": read_haptic, ".tact": read_tact}
    pattern = readers.get(path.suffix, read_hjif_array)(path)
    profile = effect_device(pattern.effect.lattice, pattern.device_name, pattern.force_max_n)
    medium = effect_medium(pattern.effect, device_grid(profile), profile.force_max_n, {"format": "test"})
    return medium[0], medium[len(medium) - 1]


def demux(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Extract the touch of a movie."""
    from touchfield.network.demux import demux as extracted

    return extracted(path, out)


def decode(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Decode all frames of a ``.touch`` file, their vibration and the materials."""
    from touchfield.pipeline.decoding import open_file
    from touchfield.render.material import stored_materials

    with open_file(path) as opened, naming_file(str(path)):
        medium = opened.medium
        if len(medium) > 64:
            raise InvalidArgument(path.name, f"{len(medium)} frames", "up to 64, so that all runs take part")
        vibration = medium.vibration
        for i in range(len(medium)):
            medium[i]
            _ = vibration and vibration(i)
        return stored_materials(medium.provenance)


def load_index(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Read the index of a folder."""
    from touchfield.tasks.library import Library

    return Library.load(path)


def read_materials(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Read a table of materials."""
    from touchfield.render.material import read_materials as read

    return read(path)


def read_deformation(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Read a deformation."""
    from touchfield.medium.deformation import read_deformation as read

    return read(path)


def read_profile(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Read a device profile, and make its lattice."""
    from touchfield.devices import device

    return device(path)


def read_trace(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Read the positions of a hand."""
    from touchfield.medium.trace import read_trace as read

    return read(path)


def read_recording(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Read the recording of a texture, and make a material of it as `touchfield texture` does."""
    from touchfield.sources.recordings.recording import read_recording as read

    return read(path)


def draw_map(path: Path, out: Path, options: dict[str, Any]) -> object:
    """Read a map or a drawing, draw it on the pins of a display, and check it."""
    from touchfield.maps.check import check
    from touchfield.maps.guidelines import PinRules
    from touchfield.maps.layout import draw
    from touchfield.maps.pins import Window
    from touchfield.maps.reader import box_of, read_map

    source = read_map(path)
    drawn = draw(source.features, Window.around(*box_of(source, None), 40, 60), PinRules(2.5), None)
    return check(drawn.layout)


# -- inputs ------------------------------------------------------------------------------------------------


def seeds(*names: str, **more: Any) -> tuple[Seed, ...]:
    """Return inputs of the corpus by their names."""
    entries = {entry.name: entry for entry in corpus.CORPUS}
    return tuple(Seed(entries[name].write, _options(entries[name].options) | more) for name in names)


def _options(words: Iterable[str]) -> dict[str, Any]:
    """Return the options that a user would type, as fields of `SourceOptions`."""
    words, out = list(words), dict[str, Any]()
    for name, value in zip(words[::2], words[1::2]):
        key = name.removeprefix("--").replace("-", "_")
        out[key] = float(value) if key in ("depth_scale", "cell_size_m", "height_scale") else value
    out.pop("mapping", None)
    return out


def fewer(write: Callable[..., Path], count: int = 300) -> Seed:
    """Return an input with fewer points."""
    return Seed(partial(write, count=count))


def file_of(name: str, content: bytes | str) -> Seed:
    """Return an input of one file."""

    def write(folder: Path) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return Seed(write)


def json_file(name: str, document: Any) -> Seed:
    """Return an input of one JSON document."""
    return file_of(name, json.dumps(document))


@cache
def stream() -> bytes:
    """Return a small ``.touch`` file of three segments, with vibration and materials."""
    from tempfile import TemporaryDirectory

    from touchfield.codec.touch.spec import TouchSpec
    from touchfield.medium import Grid, HapticMedium
    from touchfield.pipeline import encode as encode_file
    from touchfield.pipeline.spec import EncodeSpec

    walls = np.zeros((6, 12, 12, 12, 3), np.float32)
    for i, wall in enumerate(walls):
        wall[:, :, : 4 + i, 2] = 1.0 + 0.1 * i
    medium = HapticMedium.from_array(walls, Grid((12,) * 3, (0.004,) * 3, (-0.022,) * 3), 10.0)
    spec = EncodeSpec(
        touch=TouchSpec(segment_frames=2, effort="fast"), vibration="gain=0.25,frequency=80..240"
    )
    with TemporaryDirectory() as folder:
        encode_file(medium, Path(folder) / "a.touch", spec)
        return (Path(folder) / "a.touch").read_bytes()


def whole_file() -> bytes:
    """Return `stream` with the record of its start, as an attachment has it."""
    from touchfield.container import TouchReader
    from touchfield.network.touch_track import with_sync

    with TouchReader(BytesIO(stream())) as reader:
        first, last = reader.segments[0], reader.segments[-1]
    return with_sync(stream()[: last.offset + last.length], first.offset, 0.021)


def movie_bytes(maker: str, **options: Any) -> bytes:
    """Return a movie with the touch of `stream`, of a function of `movie_makers`."""
    import movie_makers as movies

    samples = movies.samples_of(stream(), 0.021, 0.021)
    if maker == "matroska":
        return bytes(movies.matroska([b"a font", whole_file()], **options))
    if maker == "klv":
        samples = [(at_s, movies.triplet(data)) for at_s, data in samples]
        maker = "transport_stream"
    return bytes(getattr(movies, maker)(samples, **options))


def movie(name: str, maker: str, **options: Any) -> Seed:
    """Return a movie with touch."""
    return Seed(lambda folder: file_of(name, movie_bytes(maker, **options)).write(folder))


def write_playlist(folder: Path) -> Path:
    """Write an HLS playlist of two parts, and a sidecar."""
    folder.mkdir()
    data = movie_bytes("transport_stream")
    half = len(data) // 376 * 188
    (folder / "b.ts").write_bytes(data[half:])
    (folder / "a.ts").write_bytes(data[:half])
    lines = ("#EXTM3U", "#EXT-X-VERSION:3", "#EXTINF:1.0,", "a.ts", "#EXTINF:1.0,", "b.ts", "#EXT-X-ENDLIST")
    (folder / "a.m3u8").write_text("\n".join(lines))
    return folder / "a.m3u8"


def effect_files() -> dict[str, tuple[Seed, ...]]:
    """Return effects by their ending."""
    import effect_makers as effects
    from hmpg_makers import FILE

    points = [effects.keyframe(0, 1.0, 80.0), effects.keyframe(100, 0.5), effects.keyframe(250, 0.0)]
    bands = [
        effects.band(kind, effects.effect(points, 20), **more)
        for kind, more in (
            ("Curve", {"curve_type": "Linear"}),
            ("Transient", {}),
            ("VectorialWave", {}),
        )
    ]
    hjif = json_file("effect.hjif", effects.document(effects.channel(*bands)))
    force = json_file("force.hjif", effects.document(effects.channel(bands[0]), modality="Force"))
    envelope = [{"time": 0, "amplitude": 0.2}, {"time": 0.3, "amplitude": 0.9}]
    envelope[1]["emphasis"] = {"amplitude": 1.0, "frequency": 0.5}  # type: ignore[assignment]
    pitch = [{"time": 0, "frequency": 0.4}, {"time": 0.3, "frequency": 0.8}]
    envelopes = {"amplitude": envelope, "frequency": pitch}
    clip = {
        "version": {"major": 1, "minor": 0, "patch": 0},
        "metadata": {"editor": "", "author": "", "source": "", "project": "", "tags": [], "description": ""},
        "signals": {"continuous": {"envelopes": envelopes}},
    }
    curve = {
        "ParameterID": "HapticIntensityControl",
        "Time": 0,
        "ParameterCurveControlPoints": [
            {"Time": 0, "ParameterValue": 0.5},
            {"Time": 0.2, "ParameterValue": 1},
        ],
    }
    tap = {"Event": {"Time": 0.2, "EventType": "HapticTransient", "EventParameters": []}}
    pattern = {"Version": 1.0, "Pattern": [tap, {"ParameterCurve": curve}]}
    return {
        "hjif": (hjif, force),
        "hmpg": (file_of("effect.hmpg", FILE),),
        "haptic": (json_file("clip.haptic", clip),),
        "ahap": (*seeds("ahap"), json_file("taps.ahap", pattern)),
        "tact": seeds("tact"),
    }


def maps(*names: str) -> tuple[Seed, ...]:
    """Return maps and drawings of the tests."""
    folder = ROOT / "tests" / "maps" / "inputs"
    return tuple(file_of(name, (folder / name).read_bytes()) for name in names)


def write_camera_yaml(folder: Path) -> Path:
    """Write a plain folder whose camera is YAML, as ROS calibrates it."""
    layouts.write_kitti(folder)
    (folder / "intrinsics.txt").unlink()
    matrix = [layouts.FX, 0, layouts.CX, 0, layouts.FY, layouts.CY, 0, 0, 1]
    (folder / "camera_info.yaml").write_text(
        f"image_width: {layouts.room.WIDTH}\nimage_height: {layouts.room.HEIGHT}\n"
        f"distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
        f"  data: [0.0, 0.0, 0.0, 0.0, 0.0]\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {matrix}\n"
    )
    return folder


def write_index(folder: Path) -> Path:
    """Write an index of a file and of a damaged one."""
    from touchfield.tasks.library import index_folder

    media = folder / "media"
    media.mkdir(parents=True)
    (media / "a.touch").write_bytes(stream())
    (media / "b.touch").write_bytes(stream()[:99])
    index_folder(media)
    return folder / "media.index.npz"


def write_materials(folder: Path) -> Path:
    """Write a table of two materials."""
    from touchfield.render.material import Material, write_table

    folder.mkdir()
    box_m = ((-1.0, -1.0, -1.0), (0.0, 1.0, 1.0))
    spectra = ((((0.01,) * 16),) * 2,) * 2
    oak = Material(
        "oak", 0.3, speeds_m_s=(0.05, 0.1), forces_n=(0.5, 1.0), texture_rms_n=spectra, box_m=box_m
    )
    write_table(folder / "table.json", (oak, Material("ice", 0.05, 0.1, 0.002)))
    return folder / "table.json"


def write_deformation(folder: Path) -> Path:
    """Write a deformation that yields."""
    from touchfield.medium.deformation import Deformation

    folder.mkdir()
    waves = 1e-4 * np.sin(np.arange(2 * 4**3 * 3)).reshape(2, 4, 4, 4, 3)
    Deformation(waves, (-0.02,) * 3, (0.04,) * 3, 10.0, 0.001, 0.2).write(folder / "bent.npz")
    return folder / "bent.npz"


def golden(*names: str) -> tuple[Seed, ...]:
    """Return streams of the conformance files."""
    folder = ROOT / "conformance" / "v1"
    return tuple(file_of(f"{name}.touch", (folder / f"{name}.touch").read_bytes()) for name in names)


def profiles() -> tuple[Seed, ...]:
    """Return device profiles."""
    folder = ROOT / "src" / "touchfield" / "devices" / "profiles"
    return tuple(file_of(path.name, path.read_bytes()) for path in sorted(folder.glob("*.toml"))[:6])


def write_packed_cloud(folder: Path, form: str) -> Path:
    """Write a PCD whose points are bytes, or bytes compressed by LZF."""
    import cloud_makers as clouds
    import scene_makers as scenes

    folder.mkdir()
    return Path(clouds.pcd(folder / "cloud.pcd", scenes.ball_points(300), form))


def write_packed_bag(folder: Path, kind: str) -> Path:
    """Write an MCAP file with compressed depth."""
    import bag_makers as bags

    folder.mkdir()
    written = bags.entries("/camera/depth/image_raw/compressedDepth", kind)
    return Path(bags.write_mcap(folder / "room.mcap", written))


def write_wav(folder: Path) -> Path:
    """Write a recording of a texture."""
    import wave

    folder.mkdir()
    samples = (3000 * np.sin(np.arange(2000) / 3)).astype("<i2")
    with wave.open(str(folder / "oak 100mm_s 1.0n.wav"), "wb") as file:
        file.setparams((1, 2, 2000, 0, "NONE", ""))
        file.writeframes(samples.tobytes())
    return folder / "oak 100mm_s 1.0n.wav"


TRACE: Final = "\n".join(["t_s,x_m,y_m,z_m", *(f"{i / 100},{i / 1000},0.0,-0.02" for i in range(20))])
TAPS: Final = "\n".join(["t_s,a_m_s2", *(f"{i / 1000:.3f},{i % 7 - 3}" for i in range(300))])
FORCES: Final = "\n".join(
    ["x_m,y_m,z_m,fx_n,fy_n,fz_n", *(f"{i % 3},{i % 4},{i % 5},0.1,0,{i}" for i in range(20))]
)


# -- mutators of files, by ending --------------------------------------------------------------------------


def touch_records(data: bytes, rng: random.Random) -> bytes:
    """Change records of a ``.touch`` file; lengths, checks and index hold."""
    from make_faulty import assembled, records_of

    try:
        records = records_of(data)
    except struct.error:
        raise text.Malformed from None
    if not records:
        raise text.Malformed
    at = rng.randrange(len(records))
    record = records[at]
    if record.tag == b"PROV" and rng.random() < 0.7:
        payload = one_of(json_tree, columns)(record.payload, rng)
    else:
        head = rng.choice((16, 48, 96, len(record.payload)))
        payload = raw(record.payload[:head], rng) + record.payload[head:]
    records[at] = record._replace(payload=payload)
    return bytes(assembled(records))


def member_mutator(name: str) -> Mutator:
    """Return the mutator of a member of an archive."""
    return mutator_of(name) if Path(name).suffix in (".npy", ".model", ".rels", ".xml", ".json") else raw


_TEXT: Final = one_of(columns, columns, raw)
_JSON: Final = one_of(json_tree, json_tree, json_tree, columns, raw)
_XML: Final = one_of(xml_tree, xml_tree, xml_tree, columns, raw)
_MP4: Final = one_of(binary.boxes, binary.boxes, raw)
_TIFF: Final = one_of(binary.tiff, binary.tiff, raw)
_ZIP: Final = one_of(*(binary.archive(member_mutator),) * 3, raw)
_HEADER: Final = one_of(header_until(b"end_header"), columns, raw)

MUTATORS: Final[dict[str, Mutator]] = {
    **dict.fromkeys((".json", ".geojson", ".gltf", ".hjif", ".haptic", ".ahap", ".tact"), _JSON),
    **dict.fromkeys((".dae", ".svg", ".xml", ".mjcf", ".urdf", ".vti", ".model", ".rels"), _XML),
    **dict.fromkeys((".npz", ".3mf", ".zip"), _ZIP),
    **dict.fromkeys((".tif", ".tiff"), _TIFF),
    **dict.fromkeys((".mp4", ".mov"), _MP4),
    ".npy": one_of(binary.npy, binary.npy, raw),
    ".png": one_of(binary.png, binary.png, raw),
    ".glb": one_of(binary.glb, binary.glb, binary.glb, raw),
    ".ts": one_of(binary.packets, binary.packets, raw),
    ".mkv": one_of(binary.elements, binary.elements, raw),
    ".mcap": one_of(binary.mcap, binary.mcap, raw),
    ".bag": one_of(binary.bag, binary.bag, raw),
    ".hmpg": one_of(binary.hmpg(bit_fields), binary.hmpg(bit_fields), binary.hmpg(raw), bit_fields, raw),
    ".touch": one_of(touch_records, touch_records, touch_records, raw),
    ".e57": one_of(binary.e57, binary.e57, binary.e57, raw),
    ".ply": _HEADER,
    ".pcd": one_of(columns, header_until(b"DATA"), raw),
    **dict.fromkeys(
        (".stl", ".las", ".laz", ".nc", ".exr", ".hgt", ".gif", ".db3", ".wav", ".bin", ".pbf"), raw
    ),
}


def mutator_of(name: str) -> Mutator:
    """Return the mutator of a file by its name; that of text for an unknown ending."""
    return MUTATORS.get(Path(name).suffix.lower(), _TEXT)


# -- the table ---------------------------------------------------------------------------------------------

_POSES: Final = (
    *("tum", "icl-nuim", "redwood", "sun3d", "3dmatch", "replica", "scannet", "colmap", "nerfstudio"),
    *("stray scanner", "polycam", "bundlefusion", "3rscan", "open3d recorder", "open3d trajectory"),
    *("realsense viewer", "plain folder", "camera_info", "decimal times"),
)
_POSE_ENDINGS: Final = (".txt", ".json", ".csv", ".log", ".freiburg", ".yaml", ".info")


def formats() -> tuple[Format, ...]:
    """Return all formats."""
    import scene_makers as scenes

    effects = effect_files()
    camera = corpus.CAMERA
    stacks = {"depth_scale": 1000.0, "intrinsics": camera}
    simulated: dict[str, Any] = {"free_s": 18.0, "free_mib": 512}
    return (
        Format("npz", encode, seeds("field npz", "npz with x and y", "npz with dy", "stereo npz")),
        Format("npy", encode, (*seeds("npy"), *seeds("npy stack")), (".npy",)),
        Format("zarr", encode, seeds("field zarr")),
        Format("vti", encode, seeds("field vti")),
        Format("HJIF", read_effect, effects["hjif"]),
        Format("HMPG", read_effect, effects["hmpg"]),
        Format("AHAP", read_effect, effects["ahap"]),
        Format("haptic", read_effect, effects["haptic"]),
        Format("tact", read_effect, effects["tact"]),
        Format("CSV of contacts", encode, (fewer(scenes.write_contacts, 60),)),
        Format("CSV of a hand", read_trace, (file_of("hand.csv", TRACE), file_of("felt.csv", FORCES))),
        Format("recording", read_recording, (Seed(write_wav), file_of("oak 100mm_s 1n.csv", TAPS))),
        Format("MCAP", encode, seeds("mcap")),
        Format(
            "MCAP, packed",
            encode,
            tuple(
                Seed(partial(write_packed_bag, kind=kind)) for kind in ("compressed", "rvl", "quantised rvl")
            ),
        ),
        Format("ROS 1 bag", encode, seeds("ros 1 bag")),
        Format("ROS 2 bag", encode, seeds("ros 2 bag")),
        Format(
            "MP4",
            demux,
            (
                movie("a.mp4", "plain_mp4"),
                movie("b.mp4", "plain_mp4", kind=b"stz2"),
                movie("c.mp4", "fragmented_mp4"),
                movie("d.mp4", "fragmented_mp4", base="file"),
            ),
        ),
        Format("MPEG-TS", demux, (movie("a.ts", "transport_stream"), movie("b.ts", "klv", step=192))),
        Format("Matroska", demux, (movie("a.mkv", "matroska"), movie("b.mkv", "matroska", is_live=True))),
        Format("HLS", demux, (Seed(write_playlist),), (".m3u8",)),
        Format("video", encode, (*seeds("film", "gif"), *seeds("depth video")), mutate=raw),
        Format("GLB", encode, seeds("glb", "moving glb", "morph glb", "sparse morph")),
        Format("glTF", encode, seeds("gltf")),
        Format("OBJ", encode, seeds("obj")),
        Format("STL", encode, seeds("stl")),
        Format("PLY", encode, (*seeds("ply"), fewer(scenes.write_cloud_ply))),
        Format("OFF", encode, seeds("off")),
        Format("3MF", encode, seeds("3mf")),
        Format("COLLADA", encode, seeds("collada")),
        # a simulation takes time and memory for the seconds that its file asks for, up to a number of steps
        Format("MJCF", encode, seeds("mujoco model", "height field"), **simulated),
        Format("URDF", encode, seeds("urdf"), **simulated),
        Format("TOML", encode, seeds("shapes", "bodies"), **simulated),
        Format("TIFF", encode, seeds("geotiff", "geotiff, gaps", "tiff pages", **stacks), (".tif",)),
        Format(
            "PNG", encode, (*seeds("depth picture", "plain folder", **stacks), *seeds("grey png")), (".png",)
        ),
        Format("LAS", encode, (fewer(scenes.write_las),)),
        Format("LAZ", encode, (fewer(scenes.write_laz),)),
        Format("E57", encode, (Seed(partial(scenes.write_e57, count=300), {"normals": "outward"}),)),
        Format("PCD", encode, (fewer(scenes.write_pcd),)),
        Format(
            "PCD, packed",
            encode,
            tuple(Seed(partial(write_packed_cloud, form=form)) for form in ("binary", "binary_compressed")),
        ),
        Format("XYZ", encode, (fewer(scenes.write_xyz), fewer(scenes.write_pts))),
        Format("ASC", encode, seeds("ascii grid")),
        Format("netCDF", encode, seeds("netcdf")),
        Format("EXR", encode, seeds("exr"), (".exr",)),
        Format("PFM", encode, seeds("middlebury")),
        Format(
            "cameras and poses", encode, (*seeds(*_POSES), Seed(write_camera_yaml, stacks)), _POSE_ENDINGS
        ),
        Format("index", load_index, (Seed(write_index),), (".npz",)),
        Format("materials", read_materials, (Seed(write_materials),)),
        Format("deformation", read_deformation, (Seed(write_deformation),)),
        Format(
            "touch",
            decode,
            (
                Seed(lambda folder: file_of("a.touch", stream()).write(folder)),
                *golden("touch-mask", "touch-lossless", "objects-touch", "objects-rigid", "paper-adpcm"),
                *golden("paper-dct", "vibration-touch"),
            ),
        ),
        Format("profile", read_profile, profiles()),
        Format("GeoJSON", draw_map, maps("floor_plan.geojson")),
        Format("OpenStreetMap", draw_map, maps("crossing.osm.pbf", "park.osm.pbf")),
        Format("SVG", draw_map, maps("triangle.svg", "parabola.svg", "cell.svg")),
    )
