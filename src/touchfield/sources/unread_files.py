"""Messages about files that no source reads: what they are by their extension, and the command that converts
them. The commands use programs of others, which are not part of touchfield."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final
from zipfile import is_zipfile

from touchfield.errors import SourceError

READABLE: Final = (
    "a mesh (.obj .ply .stl .off .gltf .glb .dae .3mf), points (.ply .pcd .las .laz .e57 .xyz .pts), "
    "bodies (.xml .urdf .toml), heights (.tif .asc .hgt .nc .npz .png), "
    "depth pictures (a folder, .png .npz .mcap .bag .mkv), a field (.npz .vti .zarr) or a .touch file"
)
"""What can be a source, in a user's words."""

READABLE_FOLDERS: Final = (
    "depth frames (depth/*.png, frame-*.depth.png and others), a ROS 2 bag or a .zarr store"
)
_PLAIN: Final = re.compile(r"[\w.-]+")
_TRIMESH: Final = (
    "pip install 'trimesh[easy]'; python -c \"import trimesh; trimesh.load({name!r}).export({to!r})\""
)
_BLENDER: Final = (
    'blender -b --python-expr "import bpy; bpy.ops.wm.read_factory_settings(use_empty=True); '
    'bpy.ops.{importer}(filepath={name!r}); bpy.ops.export_scene.gltf(filepath={to!r})"'
)
_STEP: Final = 'pip install cascadio; python -c "import cascadio; cascadio.step_to_glb({name!r}, {to!r})"'
_XACRO: Final = "pip install xacro; xacro {name} -o {to}"
_CONVERSIONS: Final[dict[str, tuple[str, str, str]]] = {
    ".amf": ("a mesh in AMF", ".glb", _TRIMESH),
    ".step": ("a solid of CAD (STEP)", ".glb", _STEP),
    ".stp": ("a solid of CAD (STEP)", ".glb", _STEP),
    ".fbx": ("a mesh in FBX", ".glb", _BLENDER.replace("{importer}", "import_scene.fbx")),
    ".usd": ("a scene in USD", ".glb", _BLENDER.replace("{importer}", "wm.usd_import")),
    ".usda": ("a scene in USD", ".glb", _BLENDER.replace("{importer}", "wm.usd_import")),
    ".usdc": ("a scene in USD", ".glb", _BLENDER.replace("{importer}", "wm.usd_import")),
    ".usdz": ("a scene in USD", ".glb", _BLENDER.replace("{importer}", "wm.usd_import")),
    ".abc": ("a scene in Alembic", ".glb", _BLENDER.replace("{importer}", "wm.alembic_import")),
    ".blend": (
        "a scene of Blender",
        ".glb",
        'blender -b {name} --python-expr "import bpy; bpy.ops.export_scene.gltf(filepath={to!r})"',
    ),
    ".xacro": ("a template of a robot (xacro)", ".urdf", _XACRO),
    ".zip": ("an archive", "", "unzip {name} -d {to}"),
    ".tar": ("an archive", "", "mkdir {to} && tar xf {name} -C {to}"),
    ".tgz": ("an archive", "", "mkdir {to} && tar xf {name} -C {to}"),
    ".gz": ("a compressed file", "", "gunzip --keep {name}"),
    ".heic": (
        "a photograph; any depth in it has to be exported",
        ".png",
        "heif-convert --with-aux {name} {to}",
    ),
}
"""For each extension: what the file is, the extension to convert it to, and the command."""


def without_triangles(path: Path, points: int) -> SourceError:
    """Return the error for a mesh file that has points but no triangle."""
    if path.suffix.lower() != ".ply" or not points:
        return SourceError(str(path), "no triangle", "a mesh of triangles", "Export it with its faces.")
    found = f"a point cloud: {points} points and no triangle"
    return SourceError(str(path), found, "a mesh of triangles", "Read it as points: --as cloud.")


def compressed_mesh(path: Path, extension: str) -> SourceError:
    """Return the error for a glTF file whose mesh is compressed by an extension."""
    name, to = _plain_name(path), "uncompressed.glb"
    fix = f"Decode it: npx @gltf-transform/cli copy {name} {to}, then encode {to}"
    return SourceError(str(path), f"a mesh compressed with {extension!r}", "one that is not", fix)


def robot_template(path: Path, found: str) -> SourceError:
    """Return the error for a robot in URDF that has expressions or elements of xacro."""
    name, to = _plain_name(path), "expanded.urdf"
    fix = f"Expand it: {_XACRO.format(name=name, to=to)}, then encode {to}"
    return SourceError(str(path), found, "a plain URDF file", fix)


def _plain_name(path: Path) -> str:
    """The name of a file for a command; a stand-in where a shell would read some characters as commands."""
    return path.name if _PLAIN.fullmatch(path.name) else f"FILE{path.suffix.lower()}"


def unread_file(path: Path) -> SourceError:
    """Return the error for a file that no source recognises.

    It names the extension and, where the format is known, a command that converts the file.
    """
    ending = path.suffix.lower()
    if ending in _CONVERSIONS:
        what, to_ending, command = _CONVERSIONS[ending]
        name = _plain_name(path)
        stem = Path(name).with_suffix("").name  # that of robot.urdf.xacro has the ending already
        to = stem.removesuffix(to_ending) + to_ending
        fix = command.format(name=name, to=to)
        then = f", then encode {to}" if ending != ".gz" else ""
        return SourceError(str(path), what, "a format that is read here", f"Convert it: {fix}{then}")
    if ending == ".npz" and not is_zipfile(path):
        return SourceError(str(path), "a damaged archive", "a whole .npz file", "Copy the file again.")
    if not ending:
        found = "a file without an extension"
    elif f"{ending} " in READABLE.replace(")", " "):
        found = f"a file {ending} whose contents are none of these"
    else:
        found = f"the extension {ending}, which is not read"
    return SourceError(str(path), found, READABLE, "Convert it to one of them.")
