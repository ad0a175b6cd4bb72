"""Small files of all other kinds of source: heights, meshes, point clouds, bodies, recordings, effects.

Each function writes into a folder that does not exist yet, and returns the path to encode.
"""

from __future__ import annotations

import gzip
import json
import shutil
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import height_makers as tiffs
from gltf_makers import CUBE, CUBE_FACES, Gltf
from mesh_makers import cube

SLOPE_M = (150.0, 150.0)
"""Extent of the map of `height_makers`: 16 x 16 samples, 10 m apart, centre to centre."""
BIG_M = (700.0, 500.0)
RNG_SEED = 3


def slope_m(x: float, y: float) -> float:
    """Return the height of `height_makers.NORTH_UP`, which rises by 15 m to the north."""
    return 100.0 + y / 10 + 0.001 * x


def hill_m(x: float, y: float) -> float:
    """Return the height of the maps written here: it rises to the east, and more to the north."""
    return 300.0 + 0.1 * x + 0.3 * y


def hill(step_m: float = 20.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions x and y, and heights [rows, cols] with row 0 in the south."""
    x, y = np.arange(0, BIG_M[0] + 1, step_m), np.arange(0, BIG_M[1] + 1, step_m)
    return x, y, hill_m(x[None, :], y[:, None])


def made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


# -- heights -----------------------------------------------------------------------------------------------
def write_geotiff(folder: Path) -> Path:
    return tiffs.geotiff(made(folder) / "dem.tif", tiffs.NORTH_UP, tiffs.SCALE, tiffs.TIE)


def write_south_up(folder: Path) -> Path:
    """A matrix with dy above 0: row 0 is south."""
    matrix = tiffs.matrix(10, 0, 5e5, 0, 10, 4.2e6)
    return tiffs.geotiff(made(folder) / "dem.tif", tiffs.NORTH_UP[::-1], matrix)


def write_scaled(folder: Path) -> Path:
    """Decimetres above 100 m in 16 bits, as GDAL's SCALE and OFFSET say."""
    stored = np.round((tiffs.NORTH_UP - 100) / 0.1).astype(np.uint16)
    scale, offset = (
        f'<Item name="{name}" sample="0" role="{name.lower()}">{value}</Item>'
        for name, value in (("SCALE", 0.1), ("OFFSET", 100))
    )
    return tiffs.geotiff(made(folder) / "dem.tif", stored, tiffs.SCALE, tiffs.TIE, tiffs.gdal(scale, offset))


def write_gaps(folder: Path) -> Path:
    """Gaps of -9999 that no tag marks."""
    values = tiffs.NORTH_UP.copy()
    values[0, 0] = values[15, 8] = -9999
    return tiffs.geotiff(made(folder) / "dem.tif", values, tiffs.SCALE, tiffs.TIE)


def write_asc(folder: Path) -> Path:
    _, _, heights = hill()
    rows, cols = heights.shape
    head = (
        f"ncols {cols}\nnrows {rows}\nxllcenter 500000\nyllcenter 4200000\ncellsize 20\nNODATA_value -9999\n"
    )
    body = "\n".join(" ".join(f"{z:.2f}" for z in row) for row in heights[::-1])
    (made(folder) / "dem.asc").write_text(f"{head}{body}\n")
    return folder / "dem.asc"


def tile_m(x: float, y: float) -> float:
    """Return the height of the tile of one degree, 0 to 1200 m from south to north."""
    from touchfield.sources.terrain.height_map import degree_m

    return round(1200 * y / degree_m(0.5)[0])


def write_hgt(folder: Path, cut: int | None = None) -> Path:
    rows = np.add.outer(1200 - np.arange(1201), np.zeros(1201, int)).astype(">i2")
    (made(folder) / "N00E010.hgt").write_bytes(rows.tobytes()[:cut])
    return folder / "N00E010.hgt"


def write_cut_hgt(folder: Path) -> Path:
    return write_hgt(folder, 1_000_000)


def write_hgt_gz(folder: Path) -> Path:
    path = write_hgt(folder)
    packed = path.with_name("N00E010.hgt.gz")
    packed.write_bytes(gzip.compress(path.read_bytes(), 1))
    path.unlink()
    return packed


def write_netcdf(folder: Path) -> Path:
    """Version 3, by SciPy; y rises."""
    from scipy.io import netcdf_file

    x, y, heights = hill()
    with netcdf_file(str(made(folder) / "dem.nc"), "w") as file:
        for name, values in (("x", x), ("y", y)):
            file.createDimension(name, len(values))
            variable = file.createVariable(name, "f8", (name,))
            variable[:], variable.units = values, "m"
        elevation = file.createVariable("elevation", "f4", ("y", "x"))
        elevation[:], elevation.units = heights, "m"
    return folder / "dem.nc"


def write_xy_npz(folder: Path) -> Path:
    x, y, heights = hill()
    np.savez(made(folder) / "dem.npz", heights=heights, x=x, y=y)
    return folder / "dem.npz"


def write_dy_npz(folder: Path) -> Path:
    np.savez(made(folder) / "dem.npz", elevation=hill()[2], dx=20.0, dy=20.0)
    return folder / "dem.npz"


def write_npy(folder: Path) -> Path:
    """Rows from the north, as in a picture; nothing states the distance of samples."""
    np.save(made(folder) / "heights.npy", hill()[2][::-1].astype(np.float32))
    return folder / "heights.npy"


def write_grey_png(folder: Path) -> Path:
    """Heights in decimetres of 16 bits, with a world file."""
    stored = np.round(10 * hill()[2][::-1]).astype(np.uint16)
    Image.fromarray(stored).save(made(folder) / "heights.png")
    (folder / "heights.pgw").write_text("20\n0\n0\n-20\n500000\n4200500\n")
    return folder / "heights.png"


# -- meshes: a cube from (0, 0, 0) to (1, 1, 1) ------------------------------------------------------------
def obj_text(vertices: np.ndarray, faces: np.ndarray) -> str:
    lines = [f"v {x:.10g} {y:.10g} {z:.10g}" for x, y, z in vertices]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in faces + 1)]) + "\n"


def write_obj(folder: Path, vertices: np.ndarray = CUBE, faces: np.ndarray = CUBE_FACES) -> Path:
    (made(folder) / "cube.obj").write_text(obj_text(vertices, faces))
    return folder / "cube.obj"


def write_duplicate(folder: Path) -> Path:
    """One triangle stands twice."""
    return write_obj(folder, faces=np.vstack([CUBE_FACES, CUBE_FACES[3:4]]))


def write_inner_sheet(folder: Path) -> Path:
    """A sheet inside the closed cube."""
    sheet = np.array([[0.3, 0.3, 0.5], [0.7, 0.3, 0.5], [0.7, 0.7, 0.5], [0.3, 0.7, 0.5]])
    faces = np.vstack([CUBE_FACES, [[8, 9, 10], [8, 10, 11]]])
    return write_obj(folder, np.vstack([CUBE, sheet]), faces)


def write_far(folder: Path) -> Path:
    """Coordinates of a map: half a million metres from the origin."""
    return write_obj(folder, CUBE + np.array([500_000.0, 4_200_000.0, 300.0]))


def write_millimetres(folder: Path) -> Path:
    """A part of 60 mm, written in millimetres."""
    return write_obj(folder, 60 * CUBE)


def triangles(vertices: np.ndarray = CUBE) -> np.ndarray:
    return vertices[CUBE_FACES].astype("<f4")


def write_stl(folder: Path) -> Path:
    """Binary."""
    records = b"".join(bytes(12) + corners.tobytes() + bytes(2) for corners in triangles())
    (made(folder) / "cube.stl").write_bytes(bytes(80) + struct.pack("<I", 12) + records)
    return folder / "cube.stl"


def write_ply(folder: Path) -> Path:
    head = ["ply", "format ascii 1.0", "element vertex 8", *(f"property float {axis}" for axis in "xyz"),
            "element face 12", "property list uchar int vertex_indices", "end_header"]  # fmt: skip
    body = [f"{x:g} {y:g} {z:g}" for x, y, z in CUBE] + [f"3 {a} {b} {c}" for a, b, c in CUBE_FACES]
    (made(folder) / "cube.ply").write_text("\n".join([*head, *body]) + "\n")
    return folder / "cube.ply"


def write_off(folder: Path) -> Path:
    body = [f"{x:g} {y:g} {z:g}" for x, y, z in CUBE] + [f"3 {a} {b} {c}" for a, b, c in CUBE_FACES]
    (made(folder) / "cube.off").write_text("\n".join(["OFF", "8 12 0", *body]) + "\n")
    return folder / "cube.off"


def cube_model(vertices: Any = CUBE, faces: Any = CUBE_FACES, **node: Any) -> Gltf:
    model = Gltf()
    model.put("nodes", mesh=model.mesh(vertices, faces), **node)
    return model


def write_glb(folder: Path) -> Path:
    return cube_model().save(made(folder) / "cube.glb", "glb")


def write_gltf(folder: Path) -> Path:
    """A node moves the cube by one metre along y."""
    return cube_model(translation=[0, 1, 0]).save(made(folder) / "cube.gltf")


def write_moving_glb(folder: Path) -> Path:
    """The cube moves from 0 to 2 m along x within a second."""
    model = cube_model()
    model.animate(0, "translation", [0, 1], [[0, 0, 0], [2, 0, 0]])
    return model.save(made(folder) / "moving.glb", "glb")


def write_morph_glb(folder: Path) -> Path:
    """A morph target makes the cube twice as high within a second."""
    model = Gltf()
    higher = np.zeros_like(CUBE)
    higher[CUBE[:, 1] > 0.5, 1] = 1.0
    model.put("nodes", mesh=model.mesh(CUBE, CUBE_FACES, targets=[higher]))
    model.animate(0, "weights", [0, 1], [[0.0], [1.0]])
    return model.save(made(folder) / "morph.glb", "glb")


def turned(points: Any, degrees: float) -> np.ndarray:
    """Return points [..., 3] turned about z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(points, float) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def write_turning_glb(folder: Path) -> Path:
    """The cube turns by a quarter about z within a second, by a cubic spline at rest at both ends."""
    model, rest, half = cube_model(), [0.0, 0, 0, 0], float(np.sqrt(0.5))
    values = [rest, [0, 0, 0, 1], rest, rest, [0, 0, half, half], rest]
    model.animate(0, "rotation", [0, 1], values, how="CUBICSPLINE")
    return model.save(made(folder) / "turning.glb", "glb")


def write_sparse_glb(folder: Path) -> Path:
    """The morph of `write_morph_glb` as a sparse accessor of the four vertices that move."""
    model = Gltf()
    indices, moves = np.flatnonzero(CUBE[:, 1] > 0.5), np.tile([0.0, 1.0, 0.0], (4, 1))
    stored = {
        "count": 4,
        "indices": {"bufferView": model.view(indices.astype("<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": model.view(moves.astype("<f4").tobytes())},
    }
    target = model.put("accessors", componentType=5126, type="VEC3", count=8, sparse=stored)
    mesh = model.mesh(CUBE, CUBE_FACES)
    model.json["meshes"][mesh]["primitives"][0]["targets"] = [{"POSITION": target}]
    model.put("nodes", mesh=mesh)
    model.animate(0, "weights", [0, 1], [[0.0], [1.0]])
    return model.save(made(folder) / "sparse.glb", "glb")


def write_mirrored_sheet(folder: Path) -> Path:
    """An open sheet that faces +z, whose scale along x becomes -1 after a second."""
    sheet = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    model = cube_model(sheet, [[0, 1, 2], [0, 2, 3]])
    model.animate(0, "scale", [0, 1, 2], [[1, 1, 1], [-1, 1, 1], [-1, 1, 1]], how="STEP")
    return model.save(made(folder) / "sheet.glb", "glb")


def write_cut_glb(folder: Path) -> Path:
    path = write_glb(folder)
    path.write_bytes(path.read_bytes()[:-100])
    return path


def write_draco(folder: Path) -> Path:
    """Needs DracoPy; without it, the kind is left out."""
    import DracoPy

    data = DracoPy.encode(CUBE.astype(np.float32), CUBE_FACES.astype(np.uint32), quantization_bits=14)
    model = Gltf()
    view, name = model.view(data), "KHR_draco_mesh_compression"
    position = model.put("accessors", count=8, componentType=5126, type="VEC3", min=[0, 0, 0], max=[1, 1, 1])
    indices = model.put("accessors", count=36, componentType=5125, type="SCALAR")
    extension = {name: {"bufferView": view, "attributes": {"POSITION": 0}}}
    primitive = {"attributes": {"POSITION": position}, "indices": indices, "mode": 4, "extensions": extension}
    model.put("nodes", mesh=model.put("meshes", primitives=[primitive]))
    model.json["extensionsUsed"] = model.json["extensionsRequired"] = [name]
    return model.save(made(folder) / "draco.glb", "glb")


def write_3mf(folder: Path) -> Path:
    """The unit is the millimetre: a cube of 1000."""
    points = "".join(f'<vertex x="{x:g}" y="{y:g}" z="{z:g}"/>' for x, y, z in 1000 * CUBE)
    faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in CUBE_FACES)
    model = (
        '<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object id="1" '
        f'type="model"><mesh><vertices>{points}</vertices><triangles>{faces}</triangles></mesh></object>'
        '</resources><build><item objectid="1"/></build></model>'
    )
    types = (
        '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default '
        'Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default '
        'Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
    )
    relations = (
        '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
        'Target="/3D/3dmodel.model" Id="rel0" '
        'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
    )
    with zipfile.ZipFile(made(folder) / "cube.3mf", "w") as archive:
        archive.writestr("[Content_Types].xml", types)
        archive.writestr("_rels/.rels", relations)
        archive.writestr("3D/3dmodel.model", model)
    return folder / "cube.3mf"


def write_dae(folder: Path) -> Path:
    points = " ".join(f"{x:g}" for x in CUBE.ravel())
    faces = " ".join(map(str, CUBE_FACES.ravel()))
    (made(folder) / "cube.dae").write_text(
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        '<asset><unit name="meter" meter="1"/><up_axis>Y_UP</up_axis></asset><library_geometries><geometry '
        'id="g" name="g"><mesh><source id="p"><float_array id="pa" count="24">'
        f'{points}</float_array><technique_common><accessor source="#pa" count="8" stride="3"><param '
        'name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>'
        '</technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f'<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles>'
        '</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">'
        '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes><scene>'
        '<instance_visual_scene url="#s"/></scene></COLLADA>\n'
    )
    return folder / "cube.dae"


def write_step(folder: Path) -> Path:
    """A faceted solid in AP214, millimetres: a cube of 1000."""
    entities: list[str] = []

    def add(text: str) -> int:
        entities.append(text)
        return len(entities)

    def listed(numbers: Any) -> str:
        return ",".join(f"#{number}" for number in numbers)

    points = [add(f"CARTESIAN_POINT('',({x:.1f},{y:.1f},{z:.1f}))") for x, y, z in 1000 * CUBE]
    faces = []
    for a, b, c in CUBE_FACES:
        normal = np.cross(CUBE[b] - CUBE[a], CUBE[c] - CUBE[a])
        z, x = (
            add("DIRECTION('',({:.1f},{:.1f},{:.1f}))".format(*(d / np.abs(d).max())))
            for d in (normal, CUBE[b] - CUBE[a])
        )
        place = add(f"AXIS2_PLACEMENT_3D('',#{points[a]},#{z},#{x})")
        loop = add(f"POLY_LOOP('',({listed(points[i] for i in (a, b, c))}))")
        bound = add(f"FACE_OUTER_BOUND('',#{loop},.T.)")
        faces.append(add(f"FACE_SURFACE('',(#{bound}),#{add(f'''PLANE('',#{place})''')},.T.)"))
    solid = add(f"FACETED_BREP('',#{add(f'''CLOSED_SHELL('',({listed(faces)}))''')})")
    length = add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    angle = add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    steradian = add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    context = add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT("
        f"(#{length},#{angle},#{steradian}))REPRESENTATION_CONTEXT('',''))"
    )
    shape = add(f"FACETED_BREP_SHAPE_REPRESENTATION('',(#{solid}),#{context})")
    application = add("APPLICATION_CONTEXT('automotive design')")
    product = add(
        f"PRODUCT('cube','cube','',(#{add(f'''PRODUCT_CONTEXT('',#{application},'mechanical')''')}))"
    )
    formation = add(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
    design = add(f"PRODUCT_DEFINITION_CONTEXT('part definition',#{application},'design')")
    definition = add(f"PRODUCT_DEFINITION('design','',#{formation},#{design})")
    whole = add(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
    add(f"SHAPE_DEFINITION_REPRESENTATION(#{whole},#{shape})")
    data = "\n".join(f"#{i + 1}={text};" for i, text in enumerate(entities))
    (made(folder) / "cube.step").write_text(
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('cube','',(''),(''),'','','');\n"
        f"FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n{data}\nENDSEC;\nEND-ISO-10303-21;\n"
    )
    return folder / "cube.step"


def write_usda(folder: Path) -> Path:
    points = ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in CUBE)
    (made(folder) / "cube.usda").write_text(
        '#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Y"\n)\ndef Mesh "cube"\n{\n'
        f"    point3f[] points = [{points}]\n    int[] faceVertexCounts = {[3] * 12}\n"
        f"    int[] faceVertexIndices = {CUBE_FACES.ravel().tolist()}\n}}\n"
    )
    return folder / "cube.usda"


def write_zip(folder: Path) -> Path:
    """An archive with one mesh."""
    with zipfile.ZipFile(made(folder) / "cube.zip", "w") as archive:
        archive.writestr("cube.obj", obj_text(*cube()))
    return folder / "cube.zip"


# -- point clouds: a ball of radius 0.5 m ------------------------------------------------------------------
def ball_points(count: int = 6000) -> np.ndarray:
    """Return points evenly on a sphere, float32 [count, 3] (Fibonacci's lattice)."""
    i = np.arange(count) + 0.5
    z, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return (0.5 * np.column_stack([r * np.cos(angle), r * np.sin(angle), z])).astype(np.float32)


def write_cloud_ply(folder: Path, count: int = 6000) -> Path:
    points = ball_points(count)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}",
            *(f"property float {axis}" for axis in "xyz"), "end_header"]  # fmt: skip
    (made(folder) / "cloud.ply").write_bytes("\n".join([*head, ""]).encode() + points.astype("<f4").tobytes())
    return folder / "cloud.ply"


def write_pcd(folder: Path, count: int = 6000) -> Path:
    points = ball_points(count)
    head = [
        "# .PCD v0.7", "VERSION 0.7", "FIELDS x y z", "SIZE 4 4 4", "TYPE F F F", "COUNT 1 1 1",
        f"WIDTH {len(points)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(points)}", "DATA ascii",
    ]  # fmt: skip
    rows = [f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    (made(folder) / "cloud.pcd").write_text("\n".join([*head, *rows]) + "\n")
    return folder / "cloud.pcd"


def write_las(folder: Path, count: int = 6000) -> Path:
    """LAS 1.2, point format 0, tenths of a millimetre."""
    points = ball_points(count)
    low, high = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
    bounds = [value for axis in range(3) for value in (high[axis], low[axis])]
    head = struct.pack(
        "<4sHHIHH8sBB32s32sHHHIIBHI5I3d3d6d", b"LASF", 0, 0, 0, 0, 0, bytes(8), 1, 2, b"", b"", 1, 2026, 227,
        227, 0, 0, 20, len(points), len(points), 0, 0, 0, 0, 1e-4, 1e-4, 1e-4, 0.0, 0.0, 0.0, *bounds,
    )  # fmt: skip
    records = np.zeros(len(points), [("xyz", "<i4", 3), ("rest", "u1", 8)])
    records["xyz"] = np.rint(1e4 * points)
    records["rest"][:, 2] = 0x09  # the only return
    (made(folder) / "cloud.las").write_bytes(head + records.tobytes())
    return folder / "cloud.las"


def write_xyz(folder: Path, count: int = 6000) -> Path:
    np.savetxt(made(folder) / "cloud.xyz", ball_points(count), "%.6f")
    return folder / "cloud.xyz"


def write_pts(folder: Path, count: int = 6000) -> Path:
    points = ball_points(count)
    np.savetxt(made(folder) / "cloud.pts", points, "%.6f", header=str(len(points)), comments="")
    return folder / "cloud.pts"


def write_laz(folder: Path, count: int = 6000) -> Path:
    """Write the LAS, compressed."""
    import laspy

    laspy.read(write_las(folder, count)).write(folder / "cloud.laz")
    (folder / "cloud.las").unlink()
    return folder / "cloud.laz"


def write_e57(folder: Path, count: int = 6000) -> Path:
    """Write one scan; the file states a scanner in the middle of the ball."""
    import pye57

    x, y, z = ball_points(count).astype(np.float64).T
    with pye57.E57(str(made(folder) / "cloud.e57"), mode="w") as file:
        file.write_scan_raw({"cartesianX": x, "cartesianY": y, "cartesianZ": z})
    return folder / "cloud.e57"


# -- bodies ------------------------------------------------------------------------------------------------
def write_shapes(folder: Path) -> Path:
    (made(folder) / "ball.toml").write_text(
        '[[shape]]\nkind = "sphere"\ncenter_m = [0.1, 0.0, 0.0]\nradius_m = 0.05\n'
    )
    return folder / "ball.toml"


def write_bodies(folder: Path) -> Path:
    """A box that falls freely for 0.1 s."""
    (made(folder) / "falling.toml").write_text(
        '[physics]\nseconds = 0.1\n\n[[body]]\nname = "brick"\nkind = "box"\n'
        "half_extents_m = [0.05, 0.05, 0.05]\nposition_m = [0.0, 0.0, 0.5]\n"
    )
    return folder / "falling.toml"


def write_mjcf(folder: Path) -> Path:
    """The keyframe puts the ball at a height of 2 m."""
    (made(folder) / "key.xml").write_text(
        '<mujoco>\n  <option gravity="0 0 0"/>\n  <worldbody>\n    <body name="ball" pos="0 0 .5">\n'
        '      <freejoint/><geom size=".1"/>\n    </body>\n  </worldbody>\n'
        '  <keyframe><key name="home" qpos="0 0 2 1 0 0 0"/></keyframe>\n</mujoco>\n'
    )
    return folder / "key.xml"


def write_height_field(folder: Path) -> Path:
    """A ramp that rises by 1 m from y = -1 to 1 m; the first row of the text is the northern one."""
    rows = " ".join(f"{z:.4f}" for z in np.repeat([1.0, 2 / 3, 1 / 3, 0.0], 6))
    (made(folder) / "ramp.xml").write_text(
        '<mujoco>\n  <asset>\n    <hfield name="h" nrow="4" ncol="6" size="2 1 1 0.1" '
        f'elevation="{rows}"/>\n  </asset>\n  <worldbody>\n    <geom type="hfield" hfield="h" '
        'pos="0 0 0.2"/>\n  </worldbody>\n</mujoco>\n'
    )
    return folder / "ramp.xml"


def write_urdf(folder: Path) -> Path:
    """A box of 0.4 x 0.2 x 0.2 m on a fixed joint, half a metre up."""
    (made(folder) / "robot.urdf").write_text(
        '<?xml version="1.0"?>\n<robot name="r">\n  <link name="base"/>\n  <link name="arm">\n'
        '    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial>\n'
        '    <collision><geometry><box size="0.4 0.2 0.2"/></geometry></collision>\n'
        '    <visual><geometry><box size="0.4 0.2 0.2"/></geometry></visual>\n  </link>\n'
        '  <joint name="j" type="fixed">\n    <parent link="base"/><child link="arm"/>\n'
        '    <origin xyz="0 0 0.5" rpy="0 0 0"/>\n  </joint>\n</robot>\n'
    )
    return folder / "robot.urdf"


# -- stored fields, recordings, video, effects -------------------------------------------------------------
def stored_field() -> tuple[np.ndarray, Any]:
    """Return forces [16, 16, 16, 3] of a wall below z = 0.016 m, and their lattice."""
    from touchfield.medium import Grid

    grid = Grid((16, 16, 16), (0.004, 0.004, 0.004), (0.0, 0.0, 0.0))
    values = np.zeros((16, 16, 16, 3), np.float32)
    z = 0.004 * np.arange(16)
    values[..., 2] = np.clip((0.018 - z) / 0.01, 0, 1)
    return values, grid


def field_points() -> tuple[np.ndarray, np.ndarray]:
    """Return samples of `stored_field`, metres [n, 3], and their forces."""
    values, grid = stored_field()
    indices = np.array([(x, y, z) for x in (4, 11) for y in (5, 10) for z in (1, 2, 3)])
    return np.asarray(grid.to_m(indices)), values[tuple(indices.T)]


def write_field_npz(folder: Path) -> Path:
    values, grid = stored_field()
    np.savez(made(folder) / "field.npz", forces_n=values[None], spacing_m=grid.spacing_m,
             origin_m=grid.origin_m, rate_hz=30.0)  # fmt: skip
    return folder / "field.npz"


def write_vti(folder: Path) -> Path:
    """As text, as ParaView writes it; x varies fastest."""
    values, _ = stored_field()
    text = " ".join(f"{v:.4g}" for v in values.transpose(2, 1, 0, 3).ravel())
    (made(folder) / "field.vti").write_text(
        '<?xml version="1.0"?>\n<VTKFile type="ImageData" version="0.1" byte_order="LittleEndian">\n'
        '  <ImageData WholeExtent="0 15 0 15 0 15" Origin="0 0 0" Spacing="0.004 0.004 0.004">\n'
        '    <Piece Extent="0 15 0 15 0 15"><PointData Vectors="forces_n">\n'
        f'      <DataArray type="Float32" Name="forces_n" NumberOfComponents="3" format="ascii">\n{text}\n'
        "      </DataArray></PointData></Piece>\n  </ImageData>\n</VTKFile>\n"
    )
    return folder / "field.vti"


def write_zarr(folder: Path) -> Path:
    from touchfield.medium import ForceField, HapticMedium
    from touchfield.medium.stores.zarr_store import write_zarr as write

    values, grid = stored_field()
    write(made(folder) / "field.zarr", HapticMedium.from_frames([ForceField.from_dense(grid, values)], 30.0))
    return folder / "field.zarr"


def probed() -> tuple[np.ndarray, np.ndarray]:
    """Return positions of a probe [n, 3], metres, and the forces of a spring to the centre, newtons."""
    points = np.random.default_rng(RNG_SEED).uniform(-0.02, 0.02, (800, 3))
    return points, -points * 100.0


def write_contacts(folder: Path, count: int = 800) -> Path:
    np.savetxt(made(folder) / "probe.csv", np.hstack(probed())[:count], "%.6f", delimiter=",",
               header="x_m,y_m,z_m,fx_n,fy_n,fz_n", comments="")  # fmt: skip
    return folder / "probe.csv"


def blinking() -> np.ndarray:
    """Return frames, uint8 [20, 64, 64, 3]: black, then a white square at the top right that grows."""
    frames = np.zeros((20, 64, 64, 3), np.uint8)
    for i in range(8, 20):
        frames[i, 8:16, 48 : 50 + i // 2] = 255
    return frames


def write_film(folder: Path) -> Path:
    from video_makers import write_video

    made(folder)
    return write_video(folder / "film.mkv", blinking(), "bgr0")


def write_gif(folder: Path) -> Path:
    """A corner changes, so that no frame is merged with the next."""
    frames = blinking()
    frames[::2, 63, 0] = 1
    pages = [Image.fromarray(frame) for frame in frames]
    pages[0].save(made(folder) / "film.gif", save_all=True, append_images=pages[1:], duration=40)
    return folder / "film.gif"


def write_uneven_gif(folder: Path) -> Path:
    """Equal frames are one with a longer time, as programs that write GIF merge them."""
    pages = [Image.fromarray(frame) for frame in blinking()]
    pages[0].save(made(folder) / "film.gif", save_all=True, append_images=pages[1:], duration=40)
    return folder / "film.gif"


def write_tact(folder: Path) -> Path:
    dots = {
        "startTime": 0,
        "endTime": 40,
        "playbackType": "NONE",
        "pointList": [{"index": 6, "intensity": 0.7}],
    }
    mode = {"mode": "DOT_MODE", "dotMode": {"dotConnected": False, "feedback": [dots]}}
    effect = {"name": "e", "startTime": 20, "offsetTime": 100, "modes": {"VestFront": mode}}
    project = {"project": {"tracks": [{"enable": True, "effects": [effect]}]}}
    (made(folder) / "effect.tact").write_text(json.dumps(project))
    return folder / "effect.tact"


def write_ahap(folder: Path) -> Path:
    parameters = [{"ParameterID": f"Haptic{name}", "ParameterValue": value}
                  for name, value in (("Intensity", 0.8), ("Sharpness", 0.5))]  # fmt: skip
    event = {
        "Time": 0.1,
        "EventType": "HapticContinuous",
        "EventDuration": 0.2,
        "EventParameters": parameters,
    }
    (made(folder) / "effect.ahap").write_text(json.dumps({"Version": 1.0, "Pattern": [{"Event": event}]}))
    return folder / "effect.ahap"


# -- what is no source -------------------------------------------------------------------------------------
def write_sound(folder: Path) -> Path:
    import wave

    with wave.open(str(made(folder) / "sound.wav"), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        file.writeframes((3000 * np.sin(np.arange(8000))).astype("<i2").tobytes())
    return folder / "sound.wav"


def write_letter(folder: Path) -> Path:
    (made(folder) / "letter.docx").write_bytes(b"PK\3\4nothing to feel")
    return folder / "letter.docx"


def write_colours_only(folder: Path) -> Path:
    """A recording whose depth pictures were not copied."""
    for i in range(3):
        Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(
            (folder if i else made(folder)) / f"colour{i}.jpg"
        )
    return folder


def remove(path: Path) -> None:
    """Remove what a maker has written."""
    shutil.rmtree(path, ignore_errors=True)
