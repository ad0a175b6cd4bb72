"""Search among media: exact neighbours, files, average precision, and separation of a known collection."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation
from sklearn.metrics import average_precision_score

from medium_corpus import GRID, PROFILE, corpus
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.errors import InvalidArgument, SourceError
from touchfield.filters.smoothing import GaussianFilter
from touchfield.measure import retrieval
from touchfield.measure.descriptors import (
    DESCRIPTOR_LENGTH,
    DESCRIPTOR_VERSION,
    PARTS,
    Descriptor,
    descriptor,
)
from touchfield.measure.retrieval import (
    ANY_POSE,
    WEIGHTS,
    MediumIndex,
    OutdatedIndex,
    distance,
)
from touchfield.medium import ForceField
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Ellipsoid, Shape


def random_descriptors(seed: int, count: int = 12) -> dict[str, Descriptor]:
    rng = np.random.default_rng(seed)
    return {f"m{i}": Descriptor(v) for i, v in enumerate(rng.random((count, DESCRIPTOR_LENGTH)).round(1))}


def index_of(entries: dict[str, Descriptor]) -> MediumIndex:
    index = MediumIndex()
    for name, entry in entries.items():
        index.add(name, entry)
    return index


# -- the search --------------------------------------------------------------------------------------------


@given(
    st.integers(0, 500),
    st.integers(1, 15),
    st.sampled_from([{}, ANY_POSE, {"support": 2.5, "amplitude": 0.1}]),
)
def test_nearest_media_agree_with_brute_force(seed: int, count: int, weights: dict[str, float]) -> None:
    entries = random_descriptors(seed)
    query = random_descriptors(seed + 1, 1)["m0"]
    expected = []
    for name, entry in entries.items():
        of_parts = {**dict.fromkeys(PARTS, 1.0), **WEIGHTS, **weights}
        square = sum(of_parts[part] * ((entry[part] - query[part]) ** 2).sum() for part in PARTS)
        expected.append((math.sqrt(square), name))
    expected.sort()
    found = index_of(entries).query(query, count, weights)
    assert len(found) == min(count, len(entries))
    assert [m.distance for m in found] == pytest.approx([d for d, _ in expected[:count]], abs=1e-12)
    assert [m.distance for m in found] == pytest.approx(
        [distance(query, entries[m.name], weights) for m in found]
    )
    assert {m.name for m in found[:1]} <= {n for d, n in expected if d == pytest.approx(expected[0][0])}


def test_equal_descriptors_have_distance_0_in_order() -> None:
    entries = random_descriptors(3, 4)
    entries["twin"] = entries["m2"]
    found = index_of(entries).query(entries["m2"], 2)
    assert [(m.name, m.distance) for m in found] == [("m2", 0.0), ("twin", 0.0)]


def test_media_are_searched_in_chunks_up_to_a_maximum(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = random_descriptors(8, 5)
    expected = index_of(entries).query(entries["m3"])
    monkeypatch.setattr(retrieval, "_BLOCK", 2)
    assert index_of(entries).query(entries["m3"]) == expected
    monkeypatch.setattr(retrieval, "MAX_MEDIA", 4)
    with pytest.raises(InvalidArgument, match="4 media; expected fewer than 4"):
        index_of(entries)


def test_media_added_later_are_found() -> None:
    entries = random_descriptors(4, 3)
    index = index_of({"m0": entries["m0"]})
    assert index.query(entries["m1"])[0].name == "m0"
    index.add("m1", entries["m1"])
    assert index.query(entries["m1"])[0].name == "m1"
    assert (len(index), "m1" in index, index.names, index["m1"]) == (2, True, ("m0", "m1"), entries["m1"])


def test_invalid_arguments_are_refused() -> None:
    entry = random_descriptors(5, 1)["m0"]
    index = MediumIndex()
    with pytest.raises(InvalidArgument, match="no medium"):
        index.query(entry)
    index.add("a", entry)
    index.add("x" * 1000, entry)
    for name in ("a", "", "x" * 1001):
        with pytest.raises(InvalidArgument, match="name"):
            index.add(name, entry)
    with pytest.raises(InvalidArgument, match="medium of the index"):
        index["b"]
    with pytest.raises(InvalidArgument, match="count"):
        index.query(entry, 0)
    for weights in ({"colour": 1.0}, {"support": -1.0}, {"support": math.nan}, dict.fromkeys(PARTS, 0.0)):
        with pytest.raises(InvalidArgument, match="weight"):
            index.query(entry, weights=weights)


# -- files -------------------------------------------------------------------------------------------------


def test_files_are_reproducible(tmp_path: Path) -> None:
    entries = random_descriptors(6)
    entries["naïve – 名"] = entries.pop("m3")
    index_of(entries).save(tmp_path / "a.npz")
    index_of(entries).save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    back = MediumIndex.load(tmp_path / "a.npz")
    assert back.names == tuple(entries)
    assert all(back[name] == entry for name, entry in entries.items())
    MediumIndex().save(tmp_path / "none.npz")
    assert len(MediumIndex.load(tmp_path / "none.npz")) == 0
    assert len(list(tmp_path.iterdir())) == 3, "no temporary file is left"
    with pytest.raises(InvalidArgument, match="no folder"):
        index_of(entries).save(tmp_path / "missing" / "a.npz")


@given(st.integers(0, 10_000), st.integers(1, 255))
def test_damaged_file_is_an_error_or_unchanged(
    tmp_path_factory: pytest.TempPathFactory, offset: int, flip: int
) -> None:
    folder = tmp_path_factory.mktemp("index")
    entries = random_descriptors(7, 3)
    index_of(entries).save(folder / "a.npz")
    data = bytearray((folder / "a.npz").read_bytes())
    (folder / "cut.npz").write_bytes(data[: offset % len(data)])
    data[offset % len(data)] ^= flip
    (folder / "b.npz").write_bytes(data)
    with pytest.raises(SourceError):
        MediumIndex.load(folder / "cut.npz")
    with contextlib.suppress(SourceError):
        restored = MediumIndex.load(folder / "b.npz")
        assert {name: restored[name] for name in restored.names} == entries


def test_other_archives_are_refused(tmp_path: Path) -> None:
    header = {
        "format": "touchfield medium index", "descriptor_version": DESCRIPTOR_VERSION, "parts": dict(PARTS),
        "names": ["a"],
    }  # fmt: skip
    values_row = np.zeros((1, DESCRIPTOR_LENGTH))

    def write_archive(values: Any = values_row, **changes: Any) -> Path:
        head = np.frombuffer(json.dumps(header | changes).encode(), np.uint8)
        np.savez(tmp_path / "x.npz", head=head, values=values)
        return tmp_path / "x.npz"

    assert MediumIndex.load(write_archive()).names == ("a",)
    wrong: list[tuple[str, Any, dict[str, Any]]] = [
        ("head: found 'a table'", values_row, {"format": "a table"}),
        ("expected 'touchfield medium index'", values_row, {"names": "a"}),
        ("'amplitude': 20", values_row, {"parts": {**PARTS, "amplitude": 20, "change": 2}}),
        (r"values: found float32 \[1, 125\]", values_row.astype(np.float32), {}),
        (r"values: found float64 \[1, 124\]; expected float64 \[1, 125\]", values_row[:, 1:], {}),
        (r"x\.npz, name: found 'a'", np.zeros((2, DESCRIPTOR_LENGTH)), {"names": ["a", "a"]}),
        (r"x\.npz, descriptor: found a number below 0", values_row - 1, {}),
    ]
    for message, values, changes in wrong:
        with pytest.raises(SourceError, match=message):
            MediumIndex.load(write_archive(values, **changes))
    with pytest.raises(
        OutdatedIndex, match=r"x\.npz: found descriptors of version 1; expected version 2.*index"
    ):
        MediumIndex.load(write_archive(descriptor_version=1))
    short = np.frombuffer(b'{"format": "touchfield medium index", "names": []}', np.uint8)
    for arrays in ({"values": values_row}, {"head": short, "values": values_row}, {"head": np.zeros(4)}):
        np.savez(tmp_path / "x.npz", **arrays)
        with pytest.raises(SourceError):
            MediumIndex.load(tmp_path / "x.npz")
    with pytest.raises(SourceError, match=r"absent\.npz: found no such file"):
        MediumIndex.load(tmp_path / "absent.npz")


# -- a collection whose kinds are known --------------------------------------------------------------------


@pytest.fixture(scope="module")
def fields() -> dict[str, ForceField]:
    return {name: field for name, _, field in corpus()}


@pytest.fixture(scope="module")
def entries(fields: dict[str, ForceField]) -> dict[str, Descriptor]:
    return {name: descriptor(field) for name, field in fields.items()}


def kind_of(name: str) -> str:
    return name.split()[0]


def precision(entries: dict[str, Descriptor], weights: dict[str, float]) -> float:
    index = index_of(entries)
    ranks = {q: [m.name for m in index.query(e, weights=weights) if m.name != q] for q, e in entries.items()}
    alike = {q: [kind_of(n) == kind_of(q) for n in names] for q, names in ranks.items()}
    return float(np.mean([average_precision_score(hits, -np.arange(len(hits))) for hits in alike.values()]))


def test_kinds_are_found_at_any_size_and_pose(entries: dict[str, Descriptor]) -> None:
    """Seven kinds of body and terrain, four of each."""
    chance = 0.2  # three alike among 27 in random order: 0.203
    only_power = {part: float(part == "direction_power") for part in PARTS}
    assert precision(entries, dict(ANY_POSE)) > 0.9
    assert precision(entries, only_power) > 0.9
    assert precision(entries, {}) > chance + 0.4
    only_directions = {part: float(part == "directions") for part in PARTS}
    assert precision(entries, only_directions) < precision(entries, only_power) - 0.3, (
        "which turn with the body"
    )


def random_solid(seed: int, scale: float = 1.0) -> AnalyticScene:
    """Three boxes and lenses of random size and pose around the origin."""
    rng = np.random.default_rng(seed)
    shapes: list[Shape] = []
    for n in range(3):
        x, y, z = (scale * rng.uniform(-0.02, 0.02, 3)).tolist()
        half = scale * rng.uniform(0.01, 0.03, 3)
        a, b, c = rng.uniform(-180, 180, 3).tolist()
        shapes.append((Box if n else Ellipsoid)((x, y, z), tuple(half.tolist()), (a, b, c)))
    return AnalyticScene(shapes, "union")


def test_a_solid_is_found_at_any_pose_position_and_size() -> None:
    """The shells find it; without them the directions of another solid are nearer."""
    solids = range(16)
    index = MediumIndex()
    for seed in solids:
        index.add(str(seed), descriptor(random_solid(seed).field(0, GRID, PROFILE)))
    found: dict[str, list[bool]] = {"default": [], "any pose": [], "without": []}
    weights = {"default": {}, "any pose": ANY_POSE, "without": {"shells": 0.0}}
    for seed in solids:
        rng = np.random.default_rng([seed, 1])
        scene = random_solid(seed, rng.uniform(0.8, 1.25))
        moved = scene.moved(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.01, 0.01, 3))
        query = descriptor(moved.field(0, GRID, PROFILE))
        for way, of_parts in weights.items():
            found[way].append(index.query(query, 1, of_parts)[0].name == str(seed))
    assert sum(found["default"]) >= 14 and sum(found["any pose"]) >= 14
    assert sum(found["without"]) <= 11


def test_a_coded_medium_finds_its_original(
    fields: dict[str, ForceField], entries: dict[str, Descriptor]
) -> None:
    index = index_of(entries)
    for name, field in fields.items():
        encoder = PaperEncoder(field.grid, PaperSpec())
        body = encoder.encode_segment([field]).body
        (back,) = PaperDecoder(field.grid, encoder.parameters).frames(body, 1)
        assert index.query(descriptor(back), 1)[0].name == name


def test_a_filtered_medium_finds_its_original(
    fields: dict[str, ForceField], entries: dict[str, Descriptor]
) -> None:
    """Spheres differ only in size, which the descriptor omits: the kind is sufficient there."""
    index = index_of(entries)
    smooth = GaussianFilter(0.35 * next(iter(fields.values())).grid.spacing_m[0])
    for name, field in fields.items():
        found = index.query(descriptor(smooth(field)), 1)[0].name
        assert kind_of(found) == kind_of(name)
        if kind_of(name) != "sphere":
            assert found == name
