"""Small glTF documents, written array by array."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

CODES = {"i1": 5120, "u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


class Gltf:
    """A document under construction; `json` may be modified before it is saved."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.data = bytearray()

    def put(self, key: str, **members: Any) -> int:
        """Append an object to a top-level list; its number."""
        self.json.setdefault(key, []).append(members)
        return len(self.json[key]) - 1

    def view(self, data: bytes, **members: Any) -> int:
        self.data += bytes(-len(self.data) % 4)
        number = self.put("bufferViews", buffer=0, byteOffset=len(self.data), byteLength=len(data), **members)
        self.data += data
        return number

    def array(self, values: Any, dtype: str = "<f4", **members: Any) -> int:
        """An accessor with a separate view."""
        values = np.asarray(values, dtype)
        values = values[:, None] if values.ndim == 1 else values.reshape(len(values), -1)
        kind = {"count": len(values), "componentType": CODES[dtype], "type": KINDS[values.shape[1]]}
        return self.put("accessors", bufferView=self.view(values.tobytes()), **kind, **members)

    def mesh(
        self, vertices: Any, faces: Any = None, targets: Any = (), mode: int = 4, **attributes: int
    ) -> int:
        primitive: dict[str, Any] = {
            "attributes": {"POSITION": self.array(vertices), **attributes},
            "mode": mode,
        }
        if faces is not None:
            primitive["indices"] = self.array(np.asarray(faces).reshape(-1), "<u2")
        if len(targets):
            primitive["targets"] = [{"POSITION": self.array(target)} for target in targets]
        return self.put("meshes", primitives=[primitive])

    def animate(
        self, node: int, path: str, times: Any, values: Any, how: str = "LINEAR", to: int = 0
    ) -> None:
        """Add a channel to animation `to`, which is created if it does not exist."""
        if to >= len(self.json.get("animations", [])):
            self.put("animations", name=f"move {to}", samplers=[], channels=[])
        animation = self.json["animations"][to]
        values = np.asarray(values, float)
        values = values.reshape(-1) if path == "weights" else values.reshape(-1, values.shape[-1])
        sampler = {"input": self.array(times), "output": self.array(values), "interpolation": how}
        animation["samplers"].append(sampler)
        target = {"node": node, "path": path}
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})

    def save(self, path: Path, how: str = "base64") -> Path:
        """Write it with its bytes in base64, in a separate file ("bin") or as GLB ("glb")."""
        data = bytes(self.data)
        buffer: dict[str, Any] = {"byteLength": len(data)}
        if how == "base64":
            buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        elif how == "bin":
            buffer["uri"] = "its%20bytes.bin"
            (path.parent / "its bytes.bin").write_bytes(data)
        self.json.setdefault("buffers", [buffer])
        text = json.dumps(self.json).encode()
        path.write_bytes(text if how != "glb" else glb(text, data))
        return path


def glb(text: bytes, data: bytes) -> bytes:
    text, data = text + b" " * (-len(text) % 4), data + bytes(-len(data) % 4)
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def moving_cube(values: Any = ((0, 0, 0), (4, 2, -6)), times: Any = (0, 1), how: str = "LINEAR") -> Gltf:
    """The unit cube, its 36 corners without indices, on a node whose translation moves."""
    gltf = Gltf()
    node = gltf.put("nodes", mesh=gltf.mesh(CUBE[CUBE_FACES.reshape(-1)]))
    gltf.animate(node, "translation", times, values, how)
    return gltf


def everything() -> Gltf:
    """Two skinned bones, morph targets, a sparse accessor, a strip and a chain of nodes, all in motion."""
    gltf = Gltf()
    corners = np.array([[x, y, z] for y in (0, 1, 2) for x in (0, 1) for z in (0, 1)], float)
    joints = gltf.array([[0, 1, 0, 0]] * 12, "u1")
    weights = gltf.array(
        [[255, 0, 0, 0]] * 4 + [[128, 127, 0, 0]] * 4 + [[0, 255, 0, 0]] * 4, "u1", normalized=True
    )
    bone = gltf.put("nodes", children=[1])
    tip = gltf.put("nodes", translation=[0, 1, 0])
    faces = [[0, 1, 5], [0, 5, 4], [4, 5, 9], [4, 9, 8], [2, 7, 3], [2, 6, 7], [6, 11, 7], [6, 10, 11]]
    skinned = gltf.mesh(corners, faces, JOINTS_0=joints, WEIGHTS_0=weights)
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, 1, 3] = -1
    skin = gltf.put("skins", joints=[bone, tip], inverseBindMatrices=gltf.array(bind.swapaxes(1, 2)))
    gltf.put("nodes", mesh=skinned, skin=skin)
    morphed = gltf.mesh(CUBE, CUBE_FACES, [CUBE * 0.5, -CUBE])
    changed = {"bufferView": gltf.view(np.array([1, 3], "<u2").tobytes()), "componentType": 5123}
    news = {"bufferView": gltf.view(np.array([[0, 0, 1], [0, 1, 0]], "<f4").tobytes())}
    sparse = {"count": 2, "indices": changed, "values": news}
    number = gltf.put("accessors", componentType=5126, count=8, type="VEC3", sparse=sparse)
    gltf.json["meshes"][morphed]["primitives"][0]["targets"].append({"POSITION": number})
    morph = gltf.put("nodes", mesh=morphed, weights=[0.5, 0, 0], children=[4])
    strip = gltf.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], mode=5)
    gltf.put("nodes", mesh=strip, matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1])
    gltf.put("scenes", nodes=[bone, 2, morph])
    half = np.sqrt(0.5)
    gltf.animate(tip, "rotation", [0, 0.1], [[0, 0, 0, 1], [0, 0, half, half]])
    gltf.animate(morph, "weights", [0, 0.05, 0.1], [[0, 0, 0], [1, 0, 1], [0, 1, 0]])
    gltf.animate(morph, "scale", [0, 0.1], np.tile([[0], [1], [0]], (2, 3)), "CUBICSPLINE")  # of slope 0
    gltf.animate(morph, "translation", [0.02, 0.1], [[0, 0, 0], [1, 1, 1]], "STEP", to=1)
    return gltf


def chain_rig(
    joints: int = 40, triangles: int = 20_000, frames: int = 200, rate_hz: float = 60.0, rigid: bool = False
) -> Gltf:
    """A snake on a swinging chain of joints: a closed tube of about `triangles` triangles.

    Smooth: each vertex follows the two nearest joints. Rigid: a closed and separate link for each joint,
    whose vertices follow that joint only. The last frame is at the end of the animation.
    """
    gltf = Gltf()
    length = joints - 1.0
    shape = (triangles / joints, 1.2, 0.76) if rigid else (triangles, 3.0, length)  # triangles of even sides
    around = max(int(np.sqrt(shape[0] * np.pi * shape[1] / shape[2])), 6)
    if rigid:
        rings = max(triangles // (2 * around * joints), 2)
        parts = [_tube(around, np.linspace(j - 0.38, j + 0.38, rings), 1.2) for j in range(joints)]
    else:
        parts = [_tube(around, np.linspace(0, length, triangles // (2 * around)), 3.0)]
    first = np.cumsum([0, *(len(v) for v, _ in parts)])
    vertices = np.concatenate([v for v, _ in parts])
    faces = np.concatenate([f + a for (_, f), a in zip(parts, first[:-1], strict=True)])
    along = np.clip(vertices[:, 1], 0, length)
    low = np.repeat(np.arange(joints), np.diff(first)) if rigid else np.minimum(along.astype(int), joints - 2)
    share = np.zeros(len(along)) if rigid else along - low
    pairs = np.stack([low, np.minimum(low + 1, joints - 1), 0 * low, 0 * low], axis=1)
    weights = np.stack([1 - share, share, 0 * share, 0 * share], axis=1)
    nodes = [
        gltf.put(
            "nodes", translation=[0, float(j > 0), 0], **({"children": [j + 1]} if j + 1 < joints else {})
        )
        for j in range(joints)
    ]
    bind = np.tile(np.eye(4), (joints, 1, 1))
    bind[:, 1, 3] = -np.arange(joints)
    skin = gltf.put("skins", joints=nodes, inverseBindMatrices=gltf.array(bind.swapaxes(1, 2)))
    mesh = gltf.mesh(vertices, faces, JOINTS_0=gltf.array(pairs, "u1"), WEIGHTS_0=gltf.array(weights))
    gltf.put("nodes", mesh=mesh, skin=skin)
    gltf.put("scenes", nodes=[nodes[0], joints])
    times = np.linspace(0, frames / rate_hz, 9)
    for j in nodes:
        swing = 0.16 * np.sin(2 * np.pi * times / times[-1] + 0.35 * j)
        gltf.animate(
            j, "rotation", times, np.stack([0 * swing, 0 * swing, np.sin(swing / 2), np.cos(swing / 2)], 1)
        )
    return gltf


def _tube(around: int, at: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed tube along y through rings at these heights, its ends points; triangles face outwards."""
    angle = 2 * np.pi * np.arange(around) / around
    ring = radius * np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], axis=1)
    body = (ring + np.array([0, 1, 0]) * at[:, None, None]).reshape(-1, 3)
    vertices = np.concatenate([body, [[0, at[0], 0], [0, at[-1], 0]]])
    i, j = np.divmod(np.arange((len(at) - 1) * around), around)
    a, b = i * around + j, i * around + (j + 1) % around
    sides = np.concatenate([np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)])
    ends = len(body)
    one, two = a[:around], b[:around]
    top = (len(at) - 1) * around
    caps = [np.stack([two, one, 0 * one + ends], 1), np.stack([one + top, two + top, 0 * one + ends + 1], 1)]
    return vertices, np.concatenate([sides, *caps])


def robot_rig(
    legs: int = 8, links: int = 5, triangles: int = 20_000, frames: int = 200, rate_hz: float = 60.0
) -> Gltf:
    """A walking robot: a body with legs of rigid links, one skinned mesh in which each vertex has one joint.

    Every link is a capsule from its joint to the next, so that neighbouring links overlap at the joint, as
    the ball and the socket of a robot do. The last frame is at the end of the animation.
    """
    gltf, count = Gltf(), 1 + legs * links
    around = max(int(np.sqrt(triangles / count * 1.2)), 6)
    rings = max(triangles // (2 * around * count), 6)
    capsule, faces = _capsule(around, rings, 1.0, 0.25)
    shapes, worlds = [_capsule(around, rings, 0.6, 0.7)[0] - [0, 0.3, 0]], [np.eye(4)]
    gltf.put("nodes", children=[1 + links * leg for leg in range(legs)])
    rests: list[Rotation] = []  # rotations of the nodes of the links
    for leg in range(legs):
        turn = 2 * np.pi * leg / legs
        for link in range(links):
            # the first link points away from the body, each further one bends downwards
            rotation, shift = Rotation.from_euler("z", -0.45 if link else -1.1), np.array([0.0, 1.0, 0.0])
            if link == 0:
                about_y = Rotation.from_euler("y", turn)
                rotation, shift = about_y * rotation, about_y.apply([0.6, 0, 0])
            local = np.eye(4)
            local[:3, :3], local[:3, 3] = rotation.as_matrix(), shift
            worlds.append((worlds[-1] if link else np.eye(4)) @ local)
            shapes.append(capsule @ worlds[-1][:3, :3].T + worlds[-1][:3, 3])
            rests.append(rotation)
            children = {"children": [len(rests) + 1]} if link + 1 < links else {}
            gltf.put("nodes", translation=shift.tolist(), rotation=rotation.as_quat().tolist(), **children)
    vertices, first = np.concatenate(shapes), len(capsule) * np.arange(count)
    number = np.repeat(np.arange(count), len(capsule))
    bind = np.linalg.inv(np.stack(worlds)).swapaxes(1, 2)
    skin = gltf.put("skins", joints=list(range(count)), inverseBindMatrices=gltf.array(bind))
    joint = gltf.array(np.stack([number, 0 * number, 0 * number, 0 * number], axis=1), "u1")
    weight = gltf.array(np.tile([1.0, 0, 0, 0], (len(number), 1)))
    mesh = gltf.mesh(vertices, np.concatenate([faces + a for a in first]), JOINTS_0=joint, WEIGHTS_0=weight)
    gltf.put("scenes", nodes=[0, gltf.put("nodes", mesh=mesh, skin=skin)])
    times = np.linspace(0, frames / rate_hz, 17)
    for n, rest in enumerate(rests):
        leg, link = divmod(n, links)
        swing = 0.25 * np.sin(4 * np.pi * times / times[-1] + np.pi * leg + 0.6 * link)
        gltf.animate(n + 1, "rotation", times, (rest * Rotation.from_euler("z", swing[:, None])).as_quat())
    return gltf


def _capsule(around: int, rings: int, length: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed capsule along y, with the centres of its ends at 0 and `length`."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 2)[1:-1]
    at = radius * np.sin(angle) + length * (angle > 0)
    vertices, faces = _tube(around, at, 1.0)
    vertices[:-2, [0, 2]] *= np.repeat(radius * np.cos(angle), around)[:, None]
    vertices[-2:, 1] = -radius, length + radius
    return vertices, faces
