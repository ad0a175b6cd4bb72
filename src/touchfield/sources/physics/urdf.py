"""Opens robots in URDF (``.urdf``, or ``.xml`` with the root ``robot``) and simulates them with MuJoCo.

Source of the format: ROS wiki, urdf/XML. Touchable are the collision shapes of the links, or the visual ones
if the robot has no collision shape at all. The first link does not move; the joints start at 0, and nothing
drives them. Duration, rate and poses are those of a MuJoCo model (`touchfield.sources.physics.mjcf`).

A mesh file is named by a path relative to the robot's file, or by ``package://NAME/PATH``. A package is
searched in the folders above the robot's file, up to the one with ``package.xml``: files outside of that
package, or without one outside of the robot's folder, need ``--allow-outside``. All formats of
`touchfield.sources.mesh.mesh_files` are read; as in ROS, the up axis that a COLLADA file states is not used.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np

from touchfield.errors import SourceError
from touchfield.files import plain_size, readable, require_in_folder
from touchfield.sources.mesh.mesh_data import MeshData, require_bounded
from touchfield.sources.mesh.mesh_files import read_mesh
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.mjcf import has_root, scene_of_model
from touchfield.sources.physics.simulation import compile_model, load_mujoco
from touchfield.sources.registry import SourceKind
from touchfield.sources.unread_files import robot_template

_MAX_BYTES: Final = 1 << 26
_KEPT: Final = ("link", "joint", "mujoco")
_KEPT_SETTINGS: Final[dict[str, dict[str, str]]] = {"compiler": {}, "option": {"timestep": "0.001"}}
"""Elements of the element mujoco that are used, and what holds where a robot states nothing."""

_SILENT: Final = ("material",)  # left out without a note, as it has no force
_XACRO: Final = re.compile(r"\$[{(]")
_XACRO_NAMESPACES: Final = ("{http://www.ros.org/wiki/xacro}", "{http://ros.org/wiki/xacro}")
_LEAST_KG, _LEAST_KG_M2 = 1e-6, 1e-9
_OVERLAP_M: Final = 1e-6
_THINNEST: Final = 1e-5  # thickness of a mesh, relative to its length


def _open(path: Path, options: SourceOptions) -> BodyScene:
    mujoco = load_mujoco()
    robot, notes = _read_robot(path)
    meshes = _RobotMeshes(path, options.allow_outside)
    for element in robot.iter("mesh"):
        element.set("filename", meshes.key_of(element.get("filename", "")))
    text = ElementTree.tostring(robot, "unicode")
    make = partial(_compile, mujoco, text, meshes)
    texts = "a robot that MuJoCo cannot read", "a whole URDF file"
    (model, more), warnings = compile_model(make, str(path), *texts)
    notes = (*notes, *meshes.notes(), *more, *warnings)
    if model.njnt and (options.seconds is None or options.seconds > 0.001):
        plural = "s" * (int(model.njnt) > 1)
        text = f"{int(model.njnt)} joint{plural} without a motor: the robot starts with all at 0 and moves by"
        notes += (f"{text} its weight; --seconds 0.001 keeps its first pose.",)
    return scene_of_model(mujoco, model, path, options, notes)


def _recognise(path: Path) -> bool:
    if not path.is_file():
        return False
    ending = path.suffix.lower()
    return ending == ".urdf" or (ending == ".xml" and has_root(path, "robot"))


# -- the elements ------------------------------------------------------------------------------------------
class _PlainBuilder(ElementTree.TreeBuilder):
    """Builds a tree, and refuses a document type, which could declare entities."""

    def doctype(self, *_: object) -> None:
        raise SourceError("", "a document type declaration", "plain URDF", "Remove the DOCTYPE.")


def _read_robot(path: Path) -> tuple[ElementTree.Element, tuple[str, ...]]:
    """Return links and joints of a robot with one kind of shapes, called collision, and notes.

    Raises `SourceError` if the file is no URDF, is a template (xacro), or has no shape.
    """
    size = plain_size(path, "a robot in URDF")
    if size > _MAX_BYTES:
        raise SourceError(str(path), f"{size} bytes", f"a robot of up to {_MAX_BYTES} bytes")
    try:
        with readable(path, "a whole URDF file"):
            data = path.read_bytes()
        source = ElementTree.fromstring(data, ElementTree.XMLParser(target=_PlainBuilder()))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SourceError(str(path), f"no XML ({error})", "a whole URDF file") from error
    except SourceError as error:
        raise SourceError(str(path), error.found, error.expected, error.hint) from None
    _refuse_templates(path, source)
    for element in source.iter():
        element.tag = element.tag.rpartition("}")[2]
    if source.tag != "robot":
        raise SourceError(str(path), f"the element {source.tag[:40]!r}", "robot")
    robot = ElementTree.Element("robot", {"name": source.get("name", "robot")})
    robot.append(_settings(source))
    kept = [element for element in source if element.tag in _KEPT]
    left_out = Counter(str(element.tag) for element in source if element.tag not in (*_KEPT, *_SILENT))
    notes = list[str]()
    if left_out:
        listed = ", ".join(f"{count} {tag[:40]}" for tag, count in left_out.most_common(8))
        notes.append(f"Elements that are not used: {listed}.")
    has_collisions = any(link.find("collision") is not None for link in source.findall("link"))
    shapes, links_without = "collision" if has_collisions else "visual", 0
    for element in kept:
        if element.tag == "link":
            links_without += has_collisions and _only_looks(element)
            robot.append(_link(element, shapes))
        elif element.tag == "joint":
            robot.append(_copied(element, 1))
    if robot.find("link/collision/geometry") is None:
        raise SourceError(str(path), "no link with a shape", "collision or visual elements in a link")
    if not has_collisions:
        notes.append("No link has a collision shape: the visual ones are touched.")
    if links_without:
        notes.append(f"Links with a visual shape only, which are left out: {links_without}.")
    return robot, tuple(notes)


def _refuse_templates(path: Path, source: ElementTree.Element) -> None:
    """Refuse expressions and elements of xacro, which stand for other text."""
    has_elements = any(element.tag.startswith(_XACRO_NAMESPACES) for element in source)
    kept = (element for element in source if element.tag.rpartition("}")[2] in ("link", "joint"))
    values = (value for element in kept for part in element.iter() for value in part.attrib.values())
    expression = next((value for value in values if _XACRO.search(value)), None)
    if has_elements or expression is not None:
        found = f"an expression of xacro, {expression[:60]!r}" if expression else "elements of xacro"
        raise robot_template(path, found)


def _settings(source: ElementTree.Element) -> ElementTree.Element:
    """Return the settings for MuJoCo that a robot has, and a time step if it states none."""
    settings = ElementTree.Element("mujoco")
    for tag, defaults in _KEPT_SETTINGS.items():
        attributes = dict(defaults)
        for element in source.findall(f"mujoco/{tag}"):
            attributes |= element.attrib
        ElementTree.SubElement(settings, tag, attributes)
    return settings


def _only_looks(link: ElementTree.Element) -> bool:
    return link.find("visual") is not None and link.find("collision") is None


def _link(link: ElementTree.Element, shapes: str) -> ElementTree.Element:
    """Return a link with its inertia and its shapes of one kind, called collision."""
    result = ElementTree.Element("link", dict(link.attrib))
    for element in link:
        if element.tag == "inertial":
            result.append(_copied(element, 1))
        elif element.tag == shapes:
            shape = ElementTree.SubElement(result, "collision")
            shape.extend(_copied(part, 1) for part in element if part.tag in ("origin", "geometry"))
    return result


def _copied(element: ElementTree.Element, depth: int) -> ElementTree.Element:
    """Return an element with the elements in it down to a depth; URDF has nothing below."""
    copied = ElementTree.Element(element.tag, dict(element.attrib))
    if depth:
        copied.extend(_copied(inner, depth - 1) for inner in element)
    return copied


# -- the meshes --------------------------------------------------------------------------------------------
class _RobotMeshes:
    """The mesh files of a robot, each read once; a key stands for a file in the model."""

    def __init__(self, path: Path, anywhere: bool) -> None:
        self._path, self._anywhere = path, anywhere
        self._keys: dict[str, str] = {}
        self._meshes: dict[str, tuple[str, MeshData]] = {}

    def key_of(self, name: str) -> str:
        """Read the file that the robot calls `name`; returns its key."""
        if name not in self._keys:
            key = f"{re.sub(r'[^A-Za-z0-9_]', '_', Path(name).stem)[:60]}_{len(self._keys)}"
            file = _find(self._path, name, self._anywhere)
            self._keys[name], self._meshes[key] = key, (file.name, read_mesh(file))
        return self._keys[name]

    def notes(self) -> tuple[str, ...]:
        """Return the notes on how the files were read."""
        return tuple(f"{name}: {note}" for name, mesh in self._meshes.values() for note in mesh.notes)

    def put_into(self, mujoco: Any, spec: Any) -> None:
        """Put vertices and triangles into the meshes of a model, in metres."""
        count = sum(len(self._meshes[mesh.file][1].triangles) for mesh in spec.meshes)
        require_bounded(str(self._path), count, self._path.stat().st_size)
        for mesh in spec.meshes:
            name, data = self._meshes[mesh.file]
            self._require_volume(name, data)
            mesh.file = ""
            mesh.uservert = (data.vertices * (data.unit_m or 1.0)).astype(np.float32).reshape(-1)
            mesh.userface = data.triangles.reshape(-1)
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX  # of an open mesh, too

    def _require_volume(self, name: str, data: MeshData) -> None:
        """Refuse a flat mesh, which has no hull that could collide."""
        points = data.vertices[np.unique(data.triangles)]
        sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(points) < 4 or not sizes[-1] > _THINNEST * sizes[0]:
            expected = "one with a volume, as a robot collides by the hulls of its meshes"
            raise SourceError(f"{self._path}: mesh {name}", "a flat mesh", expected, "Give it a thickness.")


def _find(robot: Path, name: str, anywhere: bool) -> Path:
    """Return the path of a mesh file that a robot names.

    Raises `SourceError` if it is not there, or lies outside of the robot's package.
    """
    where, scheme = f"{robot}: mesh {name[:100]!r}", name.partition("://")[0] if "://" in name else ""
    if scheme not in ("", "file", "package", "model"):
        raise SourceError(where, f"an address of kind {scheme[:20]!r}", "a path, or package://NAME/PATH")
    folder = robot.parent.resolve()
    base = next((above for above in (folder, *folder.parents) if (above / "package.xml").is_file()), folder)
    for candidate in _candidates(folder, base, name, scheme, anywhere):
        if os.path.isfile(candidate):  # False for an invalid name
            return require_in_folder(base, candidate, where, anywhere=anywhere)
    mend = "Copy it there" if anywhere else "Copy it there, or allow files elsewhere with --allow-outside"
    raise SourceError(where, f"no such file in {base}", "the mesh file", f"{mend}.")


def _candidates(folder: Path, base: Path, name: str, scheme: str, anywhere: bool) -> Iterator[Path]:
    """Yield the paths that a name may stand for; those outside of the package only if that is allowed."""
    rest = name.removeprefix(f"{scheme}://")
    if scheme in ("", "file"):
        yield folder / rest
        yield base / rest
    else:
        package, _, inner = rest.partition("/")
        above = (folder, *folder.parents)
        for place in above if anywhere else above[: above.index(base) + 1]:
            yield place / package / inner
            if place == base or place.name == package:
                yield place / inner
    yield folder / Path(rest).name


# -- the model ---------------------------------------------------------------------------------------------
def _compile(mujoco: Any, text: str, meshes: _RobotMeshes) -> tuple[Any, tuple[str, ...]]:
    """Return the model of a robot, and notes on what had to be changed.

    Masses that MuJoCo refuses are raised, inertias balanced. Links that overlap at the start do not collide.
    """
    notes: tuple[str, ...] = ()
    try:
        spec = _spec(mujoco, text, meshes)
        model = spec.compile()
    except ValueError as error:
        spec = _spec(mujoco, text, meshes)
        spec.compiler.balanceinertia = True
        spec.compiler.boundmass, spec.compiler.boundinertia = _LEAST_KG, _LEAST_KG_M2
        model = spec.compile()
        reason = " ".join(str(error).split()).partition(" Element name")[0][:120]
        notes = (f"Masses and inertias are changed to ones that can be simulated ({reason}).",)
    pairs = _overlapping(mujoco, model)
    if pairs:
        for first, second in pairs:
            spec.add_exclude(bodyname1=first, bodyname2=second)
        model = spec.compile()
        listed = ", ".join(f"{first} and {second}" for first, second in pairs[:4])
        more = ", ..." * (len(pairs) > 4)
        notes += (f"Links that overlap at the start, and so do not collide: {listed}{more}.",)
    return model, notes


def _spec(mujoco: Any, text: str, meshes: _RobotMeshes) -> Any:
    spec = mujoco.MjSpec.from_string(text)
    meshes.put_into(mujoco, spec)
    return spec


def _overlapping(mujoco: Any, model: Any) -> list[tuple[str, str]]:
    """Return the names of the bodies that overlap in the first pose, in pairs."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    body_of = model.geom_bodyid
    pairs = {
        tuple(sorted((int(body_of[contact.geom1]), int(body_of[contact.geom2]))))
        for contact in data.contact
        if contact.dist < -_OVERLAP_M
    }
    return [(model.body(first).name, model.body(second).name) for first, second in sorted(pairs)]


KIND = SourceKind("urdf", "a robot in URDF, simulated; needs the extra physics", _recognise, _open)
