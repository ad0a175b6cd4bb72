"""Readers of maps: classes, names and coordinates, what is left out, and files that a stranger may send."""

from __future__ import annotations

import json
import os
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from map_makers import INPUTS, feature, town, write_geojson
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError
from touchfield.maps import features
from touchfield.maps.reader import box_of, read_map
from touchfield.maps.symbols import class_of_tags, class_of_words, symbols

NODE = '<node id="{}" version="1" lat="{}" lon="{}"/>'


def osm_file(path: Path) -> Path:
    """A square building with a yard, as a relation, a road around it, and an entrance."""
    corners = {1: (0, 0), 2: (0, 0.001), 3: (0.001, 0.001), 4: (0.001, 0)}
    yard = {5: (0.0004, 0.0004), 6: (0.0004, 0.0006), 7: (0.0006, 0.0006), 8: (0.0006, 0.0004)}
    nodes = [NODE.format(n, lat, lon) for n, (lat, lon) in {**corners, **yard}.items()]
    nodes.append('<node id="9" version="1" lat="0.0" lon="0.0005"><tag k="entrance" v="main"/></node>')

    def way(number: int, refs: tuple[int, ...], *tags: str) -> str:
        ends = "".join(f'<nd ref="{ref}"/>' for ref in refs)
        return f'<way id="{number}" version="1">{ends}{"".join(tags)}</way>'

    def tag(key: str, value: str) -> str:
        return f'<tag k="{key}" v="{value}"/>'

    members = "".join(f'<member type="way" ref="{n}" role="{r}"/>' for n, r in ((1, "outer"), (2, "inner")))
    house = f'<relation id="1" version="1">{members}{tag("type", "multipolygon")}{tag("building", "school")}'
    parts = [
        *nodes,
        way(1, (1, 2, 3, 4, 1)),
        way(2, (5, 6, 7, 8, 5)),
        way(3, (1, 2, 3, 99), tag("highway", "residential"), tag("name", "Ring &amp; Lane")),
        way(4, (1, 3), tag("power", "line")),
        f"{house}{tag('name', 'School')}</relation>",
    ]
    path.write_text(f'<osm version="0.6">{"".join(parts)}</osm>')
    return path


def test_an_extract_has_areas_with_holes_lines_and_points(tmp_path: Path) -> None:
    pytest.importorskip("osmium")
    source = read_map(osm_file(tmp_path / "a.osm"))
    found = {feature.kind: feature for feature in source.features}
    assert set(found) == {"building", "road", "entrance"}
    assert found["building"].name == "School" and len(found["building"].parts) == 2
    assert found["road"].name == "Ring & Lane" and len(found["road"].parts[0]) == 3
    width_m = np.ptp(found["building"].parts[0][:, 0])
    assert width_m == pytest.approx(111.19, abs=0.05)  # a thousandth of a degree at the equator
    assert any("outside the extract" in note for note in source.notes)
    assert any("1 lines without a known tag" in note for note in source.notes)
    assert "ODbL" in source.attribution


def test_geojson_and_osm_agree(tmp_path: Path) -> None:
    """The same data as GeoJSON gives the same features."""
    osmium = pytest.importorskip("osmium")
    path = osm_file(tmp_path / "a.osm")
    items = []
    for item in osmium.FileProcessor(str(path)).with_locations().with_areas():
        tags = {tag.k: tag.v for tag in item.tags}
        if item.is_area() and tags:
            rings = [r for outer in item.outer_rings() for r in (outer, *item.inner_rings(outer))]
            items.append(feature("Polygon", [[[n.lon, n.lat] for n in ring] for ring in rings], **tags))
        elif item.is_way() and "highway" in tags:
            line = [[n.lon, n.lat] for n in item.nodes if n.location.valid()]
            items.append(feature("LineString", line, **tags))
        elif item.is_node() and tags:
            items.append(feature("Point", [item.lon, item.lat], **tags))
    other = read_map(write_geojson(tmp_path / "a.geojson", *items))
    for one, two in zip(read_map(path).features, other.features, strict=True):
        assert (one.kind, one.shape, one.name) == (two.kind, two.shape, two.name)
        for a, b in zip(one.parts, two.parts, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-9)


def test_a_collection_states_title_attribution_and_box(tmp_path: Path) -> None:
    """As ogr2ogr and exports of OpenStreetMap write them."""
    road = {"type": "Feature", "properties": {"highway": "primary"}, "geometry": {
        "type": "LineString", "coordinates": [[0, 0], [0.01, 0]]}}  # fmt: skip
    collection = {"type": "FeatureCollection", "features": [road]}
    stated = {"name": "High Street", "copyright": "by hand", "bbox": [0.002, -0.001, 0.004, 0.001]}
    for members, expected in (
        ({}, ("", "", None)),
        (stated, ("High Street", "by hand", (0.002, -0.001, 0.004, 0.001))),
        ({"name": 1, "attribution": "x" * 999, "bbox": [0, 0, 0, 9]}, ("", "x" * 200, None)),
    ):
        path = tmp_path / "road.geojson"
        path.write_text(json.dumps({**collection, **members}))
        read = read_map(path)
        assert (read.title, read.attribution, read.box_deg) == expected


def test_the_sample_is_the_park() -> None:
    sample, extract = read_map("sample:park"), read_map(INPUTS / "park.osm.pbf")
    assert len(sample.features) == len(extract.features) and sample.title.startswith("Nelson Square")
    assert sample.attribution == extract.attribution
    assert sample.box_deg == pytest.approx(extract.box_deg, abs=1e-6)
    with pytest.raises(InvalidArgument, match="park"):
        read_map("sample:nowhere")


def test_a_part_of_a_map_is_named_in_degrees(tmp_path: Path) -> None:
    source = read_map(write_geojson(tmp_path / "town.geojson", *town()))
    low, high = box_of(source, (0.0, 0.0, 0.0015, 0.001))
    whole = box_of(source, None)
    np.testing.assert_allclose([low, high], whole, atol=1e-6)
    with pytest.raises(InvalidArgument, match="found nothing in it; expected a part of the map"):
        box_of(source, (5.0, 5.0, 6.0, 6.0))
    for box in ((1.0, 0.0, 0.0, 1.0), (0.0, float("nan"), 1.0, 1.0), (0.0, 0.0, 0.0, 0.0)):
        with pytest.raises(InvalidArgument, match="two corners"):
            box_of(source, box)


def test_classes_follow_tags_and_words() -> None:
    assert class_of_tags({"highway": "footway", "name": "x"}, "line") == "path"
    assert class_of_tags({"building": "no"}, "area") is None
    assert class_of_tags({"building": "yes", "amenity": "school"}, "area") == "building"
    assert class_of_tags({"class": "Wasser"}, "area") == "water"
    assert class_of_words(("Layer 1", "the-walls"), "line") == "wall"
    assert class_of_words(("water",), "line") is None
    for symbol in symbols().values():
        assert symbol.shape in ("line", "area", "point") and {"en", "de"} <= set(symbol.title)
        assert not symbol.outline or symbols()[symbol.outline].shape == "line"
    priorities = [symbol.priority for symbol in symbols().values()]
    assert len(set(priorities)) == len(priorities)


def test_a_drawing_has_lines_fills_texts_and_layers(tmp_path: Path) -> None:
    pytest.importorskip("svgelements")
    path = tmp_path / "a.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 50"><g id="walls"><path id="path12" '
        'd="M0 0H100V50" fill="none" stroke="black"/></g><rect width="9" height="9" fill="#fff"/>'
        '<circle cx="20" cy="20" r="8" fill="red"/><rect class="water" x="40" y="10" width="9" height="9" '
        'fill="blue"/><line x1="0" y1="40" x2="60" y2="40" stroke="green" stroke-dasharray="9 3"/>'
        '<image href="http://example.org/a.png" width="5" height="5"/><text x="70" y="30">Saal</text></svg>'
    )
    source = read_map(path)
    assert sorted(f.kind for f in source.features) == ["dashed", "fill1", "text", "wall", "water"]
    text = next(f for f in source.features if f.kind == "text")
    assert text.name == "Saal" and source.unit_m is None
    assert any("white" in note for note in source.notes) and any(
        "other files" in note for note in source.notes
    )


def test_the_title_of_a_drawing_is_that_of_its_map(tmp_path: Path) -> None:
    pytest.importorskip("svgelements")
    path, space = tmp_path / "a.svg", 'xmlns="http://www.w3.org/2000/svg"'
    shape = "<g><title>Layer</title><path d='M0 0L9 9'/></g>".replace("<path", "<path stroke='black'")
    path.write_text(f"<svg {space}><title>The\n water cycle</title>{shape}</svg>")
    assert read_map(path).title == "The water cycle"
    path.write_text(f"<svg {space}>{shape}</svg>")
    assert read_map(path).title == ""


def test_colours_take_no_texture_of_a_class_that_the_drawing_names(tmp_path: Path) -> None:
    pytest.importorskip("svgelements")
    path = tmp_path / "a.svg"
    colours = ("#111", "#333", "#555", "#777", "#999")
    shapes = "".join(f'<rect x="{9 * n}" width="8" height="8" fill="{c}"/>' for n, c in enumerate(colours))
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg">{shapes}'
        '<g id="sea"><rect y="9" width="8" height="8" fill="#44f"/></g></svg>'
    )
    found = read_map(path)
    kinds = [feature.kind for feature in found.features]
    looks = [symbols()[kind].look for kind in kinds]
    assert kinds.count("water") == 1 and len(kinds) == 5 and len(set(looks)) == 5
    assert found.notes == ("Left out: 1 areas of further colours than 4, for want of textures.",)


def refused(path: Path, content: str | bytes, match: str) -> None:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(TouchfieldError, match=match) as caught:
        read_map(path)
    assert "\n" not in str(caught.value) and path.name in str(caught.value)


BAD_JSON: dict[str, tuple[str, str]] = {
    "no JSON": ("{", "JSON|GeoJSON"),
    "no type": ("{}", r"\$: found no 'type'"),
    "a type that is none": ('{"type": "Circle"}', r"\$\.type.*expected a type of GeoJSON"),
    "text for a number": (
        json.dumps(feature("Point", ["a", 1], amenity="x")),
        r"\$\.geometry\.coordinates\[0\]: found .*position",
    ),
    "no coordinates": ('{"type": "Feature", "properties": {"amenity": "x"}, "geometry": {"type": "Point"}}',
                       "no 'coordinates'"),
    "metres": (json.dumps(feature("Point", [500000, 5400000], amenity="x")), "in degrees.*-s_srs"),
    "half the world": (json.dumps(feature("LineString", [[0, 0], [90, 40]], highway="path")), "20 degrees"),
    "huge numbers": (json.dumps(feature("Point", [1e308, 1e308], amenity="x")), "position|degrees"),
    "another system": (
        '{"type": "FeatureCollection", "features": [], "crs": {"properties": {"name": "EPSG:31467"}}}',
        "coordinate system 'EPSG:31467'"),
    "nothing known": (json.dumps(feature("Point", [0, 0], colour="red")), "1 points without a known tag"),
    "nested": ('{"type": "GeometryCollection", "geometries": [' * 30 + "]}" * 30, "collections within"),
    "deep": ("[" * 100_000, "JSON|nested|deep"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_JSON)
def test_bad_geojson_is_one_clear_error(tmp_path: Path, case: str) -> None:
    refused(tmp_path / "a.geojson", *BAD_JSON[case])


def test_too_many_points_and_features_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert features.MAX_POINTS >= 1 << 20 and features.MAX_FEATURES >= 1 << 16
    monkeypatch.setattr(features, "MAX_POINTS", 1000)
    line = [[0, 0], [0.001, 0.001]] * 501
    refused(
        tmp_path / "a.geojson",
        json.dumps(feature("LineString", line, highway="path")),
        "more than 1000 points",
    )
    monkeypatch.setattr(features, "MAX_FEATURES", 3)
    with pytest.raises(SourceError, match="more than 3 features"):
        read_map(write_geojson(tmp_path / "b.geojson", *town()))


def test_a_feature_without_a_geometry_is_reported(tmp_path: Path) -> None:
    nothing = {"type": "Feature", "properties": {"name": "Planned"}, "geometry": None}
    source = read_map(write_geojson(tmp_path / "a.geojson", nothing, *town()))
    assert "Left out: 1 features without a geometry." in source.notes


def test_a_track_of_a_satellite_receiver_is_to_be_converted(tmp_path: Path) -> None:
    path = tmp_path / "way.gpx"
    path.write_text('<gpx version="1.1" creator="a"><wpt lat="48" lon="10"/></gpx>')
    with pytest.raises(InvalidArgument, match=r"\.gpx.*ogr2ogr OUT\.geojson way\.gpx"):
        read_map(path)


UNDRAWN = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 400 400">
<mask id="m"><rect width="11" height="9"/></mask><marker><rect width="12" height="9"/></marker>
<symbol id="s"><rect id="bench" width="13" height="9"/></symbol><use href="#s" x="200"/>
<g style="display: none"><rect width="14" height="9"/></g>
<g visibility="hidden"><rect width="15" height="9"/><rect width="16" height="9" visibility="visible"/></g>
<g opacity="0.0"><rect width="17" height="9"/><text>hidden</text></g>
<rect width="18" height="9" opacity="0.1"/>
<flowRoot><flowRegion><rect width="19" height="9"/></flowRegion><flowPara>Old</flowPara></flowRoot></svg>"""


def test_a_drawing_shows_what_a_browser_shows(tmp_path: Path) -> None:
    pytest.importorskip("svgelements")
    path = tmp_path / "a.svg"
    path.write_text(UNDRAWN)
    source = read_map(path)
    widths = sorted(round(float(np.ptp(feature.parts[0][:, 0]))) for feature in source.features)
    assert widths == [13, 16, 18]
    assert max(feature.parts[0][:, 0].max() for feature in source.features) == 213  # where `use` puts it
    assert set(source.notes) == {
        "Left out: 4 hidden layers or elements.",
        "Left out: 1 flowed texts (Inkscape: Text, Convert to Text).",
    }


@pytest.mark.parametrize(("dashes", "kind"), [("4,4", "dashed"), ("1 3", "dotted"), ("none", "solid")])
def test_dashes_have_the_scale_of_their_line(tmp_path: Path, dashes: str, kind: str) -> None:
    pytest.importorskip("svgelements")
    path = tmp_path / "a.svg"
    line = f'<path d="M0 0H90" stroke="#000" fill="none" style="stroke-width:1;stroke-dasharray:{dashes}"/>'
    size = 'width="210mm" height="148mm" viewBox="0 0 210 148"'  # 3.8 pixels in a unit
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{line}</svg>')
    assert [feature.kind for feature in read_map(path).features] == [kind]


BOMB = '<!DOCTYPE svg [<!ENTITY a "{}">]><svg xmlns="http://www.w3.org/2000/svg"><text>&a;</text></svg>'
USES = "".join(f'<g id="g{n}">{f"<use href=#g{n + 1}#/>" * 10}</g>'.replace("#g", '"#g').replace("#/", '"/')
               for n in range(12))  # fmt: skip
BAD_SVG: dict[str, tuple[str, str]] = {
    "no XML": ("<svg", "no XML"),
    "a name with two colons": ('<svg xmlns:a="b" a:b:c="1"/>', "no XML"),
    "a prefix without a namespace": ("<svg><a:b/></svg>", "no XML"),
    "an unknown encoding": ('<?xml version="1.0" encoding="UTF255"?><svg/>', "no XML"),
    "an encoding of many bytes": ('<?xml version="1.0" encoding="gb18030"?><svg/>', "no XML"),
    "another root": ("<html/>", "the element 'html'"),
    "entities": (BOMB.format("x" * 99), "a document type with declarations.*plain SVG"),
    "instances of instances": (
        f'<svg xmlns="http://www.w3.org/2000/svg"><defs>{USES}</defs><use href="#g0"/></svg>', "elements"),
    "an instance of itself": (
        '<svg xmlns="http://www.w3.org/2000/svg"><g id="a"><use href="#a"/></g></svg>', "within itself"),
    "deep nesting": (f"<svg>{'<g>' * 300}{'</g>' * 300}</svg>", "257 deep"),
    "nothing": ('<svg xmlns="http://www.w3.org/2000/svg"/>', "nothing that can be drawn"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_SVG)
def test_a_bad_drawing_is_one_clear_error(tmp_path: Path, case: str) -> None:
    pytest.importorskip("svgelements")
    refused(tmp_path / "a.svg", *BAD_SVG[case])


@pytest.mark.parametrize("suffix", [".osm", ".osm.pbf"])
def test_a_bad_extract_is_one_clear_error(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("osmium")
    contents: tuple[bytes, ...] = (b"", b"\0" * 64, b"<osm", (INPUTS / "park.osm.pbf").read_bytes()[:999])
    if suffix == ".osm":
        contents += (
            b'<!DOCTYPE osm [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><osm version="0.6"><note>&b;</note></osm>',
        )
    for content in contents:
        refused(tmp_path / f"a{suffix}", content, "pyosmium does not read|nothing that can be drawn")


def test_only_plain_files_with_a_known_ending_are_opened(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match=r"found the ending '.txt'; expected a map or a drawing"):
        read_map(tmp_path / "a.txt")
    pytest.importorskip("osmium")
    pytest.importorskip("svgelements")
    for suffix in (".geojson", ".svg", ".osm"):
        path = tmp_path / f"a{suffix}"
        with pytest.raises(SourceError, match="no such file"):
            read_map(path)
        os.mkfifo(path)
        with pytest.raises(SourceError, match="a pipe, a socket or a device"):
            read_map(path)


def mutants(data: bytes, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    damaged = bytearray(data)
    for position in rng.integers(len(data), size=6):
        damaged[position] = rng.integers(256)
    return bytes(damaged[: len(damaged) if seed % 3 else int(rng.integers(len(damaged)))])


@pytest.mark.parametrize("name", ["floor_plan.geojson", "park.osm.pbf", "cell.svg"])
def test_damaged_files_are_read_or_refused(tmp_path: Path, name: str) -> None:
    library = {".pbf": "osmium", ".svg": "svgelements"}.get(Path(name).suffix)
    if library:
        pytest.importorskip(library)
    outcomes = Counter[str]()
    for seed in range(40):
        path = tmp_path / name
        path.write_bytes(mutants((INPUTS / name).read_bytes(), seed))
        try:
            source = read_map(path)
        except TouchfieldError as error:
            outcomes["refused" if "\n" not in str(error) else "garbled"] += 1
        else:
            assert all(np.isfinite(part).all() for f in source.features for part in f.parts)
            outcomes["read"] += 1
    assert outcomes["refused"] > 0 and not outcomes["garbled"]
