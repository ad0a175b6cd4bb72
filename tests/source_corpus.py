"""A corpus of inputs of many kinds, right and wrong, each with what a user would type first and a truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import layout_makers as layouts
import recording_makers as recordings
import room_makers as room
import scene_makers as scenes
import source_truth as truth
import texture_makers as textures

CAMERA = ",".join(map(str, room.CAMERA))
SEEN, SEEN_ONCE = truth.seen_by_cameras(), truth.seen_by_cameras((0,), 1)
SLOPE = truth.heights(scenes.slope_m, scenes.SLOPE_M, 100.0)
HILL = truth.heights(scenes.hill_m, scenes.BIG_M, 300.0)
CUBE, BALL = truth.box((0, 0, 0), (1, 1, 1)), truth.sphere(0.5)
TILE = truth.heights(scenes.tile_m, (110_800.0, 110_500.0), 0.0)
MOVED = truth.contacts([*truth.box_rays((0, 0, 0), (1, 1, 1)), *truth.box_rays((1, 0, 0), (2, 1, 1), 30)], 60)
GROWN = truth.contacts(
    [*truth.box_rays((0, 0, 0), (1, 1, 1)), *truth.box_rays((0, 0, 0), (1, 1.5, 1), 30)], 60
)
TURNED = truth.contacts(
    [
        *truth.box_rays((0, 0, 0), (1, 1, 1)),
        truth.Ray(scenes.turned((1.4, 0.5, 0.5), 45), scenes.turned((-1, 0, 0), 45), 0.4, 30),
        truth.Ray(scenes.turned((0.5, 1.4, 0.5), 45), scenes.turned((0, -1, 0), 45), 0.4, 30),
    ],
    60,
)
RAMP_NORMAL = (0, -0.447, 0.894)
RAMP = truth.contacts(
    [
        truth.Ray((x, y, 2.0), (0, 0, -1), 2.0 - (0.2 + (y + 1) / 2), 0, RAMP_NORMAL)
        for x in (-1, 0, 1)
        for y in (-0.6, 0, 0.6)
    ]
)
FIELD = truth.forces(*scenes.field_points())
BLINK = truth.driven(0.66, (6, 6), 0.1, 0.8)
MOVED_UP = truth.box((0, 1, 0), (1, 2, 1))
SPRING = truth.forces(*(values[:300] for values in scenes.probed()))
SLID = truth.forces(*textures.slid())
DOTS = truth.driven(0.03, (2, 3), 0.08, 0.12)


@dataclass(frozen=True)
class Input:
    """One input.

    name : its name in the table.
    kind : what it is, in a user's words; several inputs may be of one kind.
    write : called with a folder that does not exist; returns the path to give to the command.
    truth : the check of the decoded file.
    options : what a user would type first.
    answers : what the user knows and a message may ask for, by option.
    mended : writes the input as it is without its damage; None if it has none.
    needs : modules without which the input cannot be written.
    is_layout : it is right, and belongs on the page of layouts.
    is_foreign : it is a format of other programs, which may be read, or refused with a conversion.
    """

    name: str
    kind: str
    write: Callable[[Path], Path]
    truth: truth.Truth
    options: tuple[str, ...] = ()
    answers: dict[str, str] = field(default_factory=dict)
    mended: Callable[[Path], Path] | None = None
    needs: tuple[str, ...] = ()
    is_layout: bool = True
    is_foreign: bool = False
    command: str = "encode"

    @property
    def is_available(self) -> bool:
        """Everything that writes the input is installed."""
        return all(find_spec(name) is not None for name in self.needs)


def cut(write: Callable[[Path], Path]) -> Callable[[Path], Path]:
    """Return a writer of the same file, cut to six tenths of its bytes."""

    def write_cut(folder: Path) -> Path:
        path = write(folder)
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
        return path

    return write_cut


MM, KNOWN = ("--depth-scale", "1000"), {"--intrinsics": CAMERA, "--depth-scale": "1000"}
VEST = ("--device", "tactile-vest-8x8")

CORPUS = [
    # depth sequences of one room
    Input("tum", "depth: TUM RGB-D", layouts.write_tum, SEEN),
    Input("icl-nuim", "depth: ICL-NUIM", layouts.write_icl, SEEN),
    Input("redwood", "depth: Redwood, Open3D", layouts.write_redwood, SEEN),
    Input("sun3d", "depth: SUN3D", layouts.write_sun3d, SEEN),
    Input("3dmatch", "depth: 3DMatch, 7-Scenes", layouts.write_threedmatch, SEEN),
    Input("7-scenes nested", "depth: 3DMatch, 7-Scenes", recordings.write_seven_scenes, SEEN),
    Input("replica", "depth: Replica (NICE-SLAM)", layouts.write_replica, SEEN),
    Input("scannet", "depth: ScanNet", layouts.write_scannet, SEEN, MM),
    Input("colmap", "depth: COLMAP", layouts.write_colmap, SEEN, MM),
    Input("nerfstudio", "depth: nerfstudio", recordings.write_nerfstudio, SEEN),
    Input("stray scanner", "depth: Stray Scanner", recordings.write_stray, SEEN),
    Input("polycam", "depth: Polycam", recordings.write_polycam, SEEN),
    Input("bundlefusion", "depth: BundleFusion", recordings.write_bundlefusion, SEEN),
    Input("3rscan", "depth: 3RScan", recordings.write_3rscan, SEEN),
    Input("open3d recorder", "depth: Open3D's RealSense and Azure Kinect", recordings.write_open3d, SEEN),
    Input("open3d trajectory", "depth: Open3D's trajectory", layouts.write_open3d_trajectory, SEEN, MM),
    Input("realsense viewer", "depth: RealSense viewer", recordings.write_realsense, SEEN),
    Input("mcap", "depth: ROS 2 bag", lambda folder: _bag(folder, "mcap"), SEEN, needs=("mcap_ros2",)),
    Input("ros 2 bag", "depth: ROS 2 bag", lambda folder: _bag(folder, "db3"), SEEN, needs=("mcap_ros2",)),
    Input("ros 1 bag", "depth: ROS 1 bag", lambda folder: _bag(folder, "bag"), SEEN, needs=("rosbags",)),
    Input("plain folder", "depth: plain folder", layouts.write_kitti, SEEN, MM),
    Input(
        "camera_info",
        "depth: camera_info with a bent lens",
        layouts.write_camera_info,
        SEEN,
        MM,
        needs=("cv2",),
    ),
    Input("decimal times", "depth: plain folder", layouts.write_unpadded_times, SEEN, MM),
    Input("exr", "depth: EXR", layouts.write_exr_folder, SEEN, needs=("OpenEXR",)),
    Input("tiff pages", "depth: TIFF with pages", layouts.write_tiff_pages, SEEN, MM),
    Input("npy stack", "depth: NPY stack", layouts.write_npy_stack, SEEN),
    Input("stereo npz", "depth: disparity in .npz", layouts.write_disparity_npz, SEEN_ONCE),
    Input("middlebury", "depth: disparity map", layouts.write_middlebury, SEEN_ONCE),
    Input(
        "depth video",
        "depth: 16-bit video",
        layouts.write_video,
        truth.seen_by_cameras((0,)),
        (*MM, "--intrinsics", CAMERA, "--world", "frames"),
        needs=("av",),
    ),
    Input(
        "depth picture",
        "depth: one picture",
        layouts.write_one_picture,
        SEEN_ONCE,
        (*MM, "--intrinsics", CAMERA),
    ),
    Input(
        "textbook",
        "depth: plain folder without camera and unit",
        layouts.write_slambook,
        SEEN,
        answers=KNOWN,
        is_layout=False,
    ),
    # heights
    Input("geotiff", "heights: GeoTIFF", scenes.write_geotiff, SLOPE),
    Input("geotiff, south up", "heights: GeoTIFF", scenes.write_south_up, SLOPE),
    Input("geotiff, scale and offset", "heights: GeoTIFF", scenes.write_scaled, SLOPE),
    Input("geotiff, gaps", "heights: GeoTIFF", scenes.write_gaps, SLOPE),
    Input("ascii grid", "heights: .asc", scenes.write_asc, HILL),
    Input("srtm tile", "heights: .hgt", scenes.write_hgt, TILE),
    Input("netcdf", "heights: netCDF", scenes.write_netcdf, HILL, needs=("scipy",)),
    Input("npz with x and y", "heights: .npz", scenes.write_xy_npz, HILL),
    Input("npz with dy", "heights: .npz", scenes.write_dy_npz, HILL),
    Input("npy", "heights: .npy", scenes.write_npy, HILL, ("--cell-size-m", "20")),
    Input(
        "grey png",
        "heights: grey picture with a world file",
        scenes.write_grey_png,
        HILL,
        ("--height-scale", "0.1"),
    ),
    # meshes and models
    Input("obj", "mesh: OBJ", scenes.write_obj, CUBE),
    Input("stl", "mesh: STL", scenes.write_stl, CUBE),
    Input("ply", "mesh: PLY", scenes.write_ply, CUBE),
    Input("off", "mesh: OFF", scenes.write_off, CUBE),
    Input("glb", "mesh: glTF", scenes.write_glb, CUBE),
    Input("gltf", "mesh: glTF", scenes.write_gltf, MOVED_UP),
    Input("triangle twice", "mesh: OBJ", scenes.write_duplicate, CUBE, is_layout=False),
    Input("sheet inside", "mesh: OBJ", scenes.write_inner_sheet, CUBE, is_layout=False),
    Input(
        "map coordinates",
        "mesh: OBJ",
        scenes.write_far,
        truth.box((500_000, 4_200_000, 300), (500_001, 4_200_001, 301)),
        is_layout=False,
    ),
    Input("moving glb", "model: animated glTF", scenes.write_moving_glb, MOVED),
    Input("morph glb", "model: animated glTF", scenes.write_morph_glb, GROWN),
    Input("turning glb", "model: animated glTF", scenes.write_turning_glb, TURNED, is_layout=False),
    Input("sparse morph", "model: animated glTF", scenes.write_sparse_glb, GROWN, is_layout=False),
    Input(
        "mirrored sheet",
        "model: animated glTF",
        scenes.write_mirrored_sheet,
        truth.contacts(
            [truth.Ray((x, 0.4, 0.5), (0, 0, -1), 0.5, frame) for x in (-0.5, 0.5) for frame in (0, 80)]
        ),
        is_layout=False,
    ),
    Input("3mf", "mesh: 3MF", scenes.write_3mf, CUBE, needs=("lib3mf",)),
    Input("collada", "mesh: COLLADA", scenes.write_dae, CUBE, needs=("collada",)),
    Input("step", "solid: STEP", scenes.write_step, CUBE, is_foreign=True),
    Input("usd", "scene: USD", scenes.write_usda, CUBE, is_foreign=True),
    Input("draco", "mesh: glTF with Draco", scenes.write_draco, CUBE, needs=("DracoPy",), is_foreign=True),
    Input("zip", "archive", scenes.write_zip, CUBE, is_layout=False),
    Input("gz", "compressed file", scenes.write_hgt_gz, TILE, is_layout=False),
    # point clouds
    Input("cloud ply", "point cloud: PLY", scenes.write_cloud_ply, BALL),
    Input("cloud pcd", "point cloud: PCD", scenes.write_pcd, BALL),
    Input("cloud las", "point cloud: LAS", scenes.write_las, BALL, needs=("laspy",)),
    Input("cloud laz", "point cloud: LAZ", scenes.write_laz, BALL, needs=("laspy", "lazrs")),
    Input(
        "cloud e57", "point cloud: E57", scenes.write_e57, BALL, ("--normals", "outward"), needs=("pye57",)
    ),
    Input("cloud xyz", "point cloud: XYZ", scenes.write_xyz, BALL),
    Input("cloud pts", "point cloud: PTS", scenes.write_pts, BALL),
    # bodies
    Input("shapes", "shapes: .toml", scenes.write_shapes, truth.sphere(0.05, (0.1, 0, 0))),
    Input(
        "bodies",
        "bodies: .toml",
        scenes.write_bodies,
        truth.box((-0.05, -0.05, 0.45), (0.05, 0.05, 0.55), frame_count=100),
        needs=("mujoco",),
    ),
    Input("mujoco model", "bodies: MJCF", scenes.write_mjcf, truth.sphere(0.1, (0, 0, 2)), needs=("mujoco",)),
    Input(
        "height field", "bodies: MJCF", scenes.write_height_field, RAMP, needs=("mujoco",), is_layout=False
    ),
    Input(
        "urdf",
        "robot: URDF",
        scenes.write_urdf,
        truth.box((-0.2, -0.1, 0.4), (0.2, 0.1, 0.6)),
        needs=("mujoco",),
    ),
    # fields, recordings, video, effects
    Input("field npz", "field: .npz", scenes.write_field_npz, FIELD, ("--mapping", "1")),
    Input("field vti", "field: .vti", scenes.write_vti, FIELD, ("--mapping", "1")),
    Input("field zarr", "field: .zarr", scenes.write_zarr, FIELD, ("--mapping", "1"), needs=("zarr",)),
    Input(
        "contacts",
        "recorded contacts: .csv",
        scenes.write_contacts,
        SPRING,
    ),
    Input("matlab contacts", "recorded contacts: MATLAB", textures.write_spring_mat, SPRING),
    Input("cluster textures", "recorded contacts: Cluster dataset", textures.write_slides, SLID),
    Input("film", "video, for a vest", scenes.write_film, BLINK, VEST, needs=("av",)),
    Input("gif", "video, for a vest", scenes.write_gif, BLINK, VEST, needs=("av",)),
    Input(
        "gif of uneven times",
        "wrong: times of a video",
        scenes.write_uneven_gif,
        BLINK,
        VEST,
        needs=("av",),
        is_layout=False,
    ),
    Input("tact", "effect: .tact", scenes.write_tact, DOTS, command="import"),
    Input(
        "ahap", "effect: .ahap", scenes.write_ahap, truth.driven(0.15, (0, 0), 0.02, 0.32), command="import"
    ),
    # wrong inputs
    Input(
        "inverted poses",
        "wrong: poses",
        lambda f: layouts.write_kitti(f, _inverted()),
        SEEN,
        MM,
        is_layout=False,
    ),
    Input(
        "OpenGL poses",
        "wrong: poses",
        lambda f: layouts.write_kitti(f, layouts.POSES @ room.OPENGL),
        SEEN,
        MM,
        is_layout=False,
    ),
    Input("w first", "wrong: poses", layouts.write_w_first, SEEN, MM, is_layout=False),
    Input(
        "wrong depth unit",
        "wrong: depth unit",
        layouts.write_kitti,
        SEEN,
        ("--depth-scale", "100"),
        is_layout=False,
    ),
    Input(
        "8-bit depth",
        "wrong: 8-bit depth",
        layouts.write_eight_bits,
        SEEN,
        MM,
        mended=layouts.write_kitti,
        is_layout=False,
    ),
    Input(
        "cut picture",
        "wrong: cut file",
        layouts.write_cut_picture,
        SEEN,
        MM,
        mended=layouts.write_kitti,
        is_layout=False,
    ),
    Input("cut glb", "wrong: cut file", scenes.write_cut_glb, CUBE, mended=scenes.write_glb, is_layout=False),
    Input(
        "cut stl", "wrong: cut file", cut(scenes.write_stl), CUBE, mended=scenes.write_stl, is_layout=False
    ),
    Input(
        "cut ply", "wrong: cut file", cut(scenes.write_ply), CUBE, mended=scenes.write_ply, is_layout=False
    ),
    Input(
        "cut gltf",
        "wrong: cut file",
        cut(scenes.write_gltf),
        MOVED_UP,
        mended=scenes.write_gltf,
        is_layout=False,
    ),
    Input(
        "cut npz",
        "wrong: cut file",
        cut(scenes.write_xy_npz),
        HILL,
        mended=scenes.write_xy_npz,
        is_layout=False,
    ),
    Input(
        "cut asc", "wrong: cut file", cut(scenes.write_asc), HILL, mended=scenes.write_asc, is_layout=False
    ),
    Input(
        "cut geotiff",
        "wrong: cut file",
        cut(scenes.write_geotiff),
        SLOPE,
        mended=scenes.write_geotiff,
        is_layout=False,
    ),
    Input(
        "cut netcdf",
        "wrong: cut file",
        cut(scenes.write_netcdf),
        HILL,
        mended=scenes.write_netcdf,
        needs=("scipy",),
        is_layout=False,
    ),
    Input(
        "cut csv",
        "wrong: cut file",
        cut(scenes.write_contacts),
        SPRING,
        mended=scenes.write_contacts,
        is_layout=False,
    ),
    Input(
        "cut video",
        "wrong: cut file",
        cut(scenes.write_film),
        BLINK,
        VEST,
        mended=scenes.write_film,
        needs=("av",),
        is_layout=False,
    ),
    Input(
        "cut gif",
        "wrong: cut file",
        cut(scenes.write_gif),
        BLINK,
        VEST,
        mended=scenes.write_gif,
        needs=("av",),
        is_layout=False,
    ),
    Input(
        "cut tact",
        "wrong: cut file",
        cut(scenes.write_tact),
        DOTS,
        mended=scenes.write_tact,
        is_layout=False,
        command="import",
    ),
    Input(
        "cut model",
        "wrong: cut file",
        cut(scenes.write_mjcf),
        truth.sphere(0.1, (0, 0, 2)),
        mended=scenes.write_mjcf,
        needs=("mujoco",),
        is_layout=False,
    ),
    Input(
        "cut tile", "wrong: cut file", scenes.write_cut_hgt, TILE, mended=scenes.write_hgt, is_layout=False
    ),
    Input(
        "millimetres",
        "wrong: mesh unit",
        scenes.write_millimetres,
        truth.box((0, 0, 0), (0.06, 0.06, 0.06)),
        is_layout=False,
    ),
    Input(
        "no depth",
        "wrong: no depth",
        scenes.write_colours_only,
        SEEN,
        mended=layouts.write_tum,
        is_layout=False,
    ),
    Input("sound", "wrong: no source", scenes.write_sound, CUBE, mended=scenes.write_obj, is_layout=False),
    Input("letter", "wrong: no source", scenes.write_letter, CUBE, mended=scenes.write_obj, is_layout=False),
]


def _bag(folder: Path, store: str) -> Path:
    import bag_makers as bags

    if store == "db3":
        return bags.write_db3(folder, bags.entries())
    if store == "bag":
        return bags.write_ros1(scenes.made(folder) / "room.bag", bags.entries())
    return bags.write_mcap(scenes.made(folder) / "room.mcap", bags.entries())


def _inverted() -> np.ndarray:
    return np.linalg.inv(layouts.POSES)
