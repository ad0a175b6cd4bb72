"""Every limit of an argument at its edge: the last accepted value, and the first refused one."""

from __future__ import annotations

import io
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from touchfield.cli.options import frames_of, numbers_of
from touchfield.compute.executors import executor_of
from touchfield.compute.threads import for_chunks, worker_count
from touchfield.errors import (
    CorruptFile,
    DeviceError,
    ForeignFile,
    InvalidArgument,
    MissingExtra,
    SourceError,
    TouchfieldError,
    TruncatedFile,
    UnsupportedVersion,
    as_source_error,
    import_extra,
    reason,
    require_between,
    require_ending,
    require_kinds,
    require_not_negative,
    require_one_of,
    require_positive,
    require_up_to,
)
from touchfield.files import (
    json_of,
    plain_size,
    read_bytes,
    read_up_to,
    refuse_overwriting,
    require_in_folder,
)
from touchfield.json_values import JsonValue, parsed, read_json
from touchfield.network.access import Access
from touchfield.options import address
from touchfield.pipeline.spec import EncodeSpec, Motion, ReductionSpec, require_frames
from touchfield.tasks.live import LiveSpec
from touchfield.tasks.measure import MeasureSpec
from touchfield.tasks.play import PlaySpec

BELOW, ABOVE = -math.inf, math.inf


def beyond(value: float, direction: float) -> float:
    """The next number beyond a value."""
    return math.nextafter(value, direction)


CHECKS: dict[str, tuple[Callable[[Any], Any], tuple[Any, ...], tuple[Any, ...], str]] = {
    "positive": (lambda v: require_positive(mine=v), (5e-324, 1e308), (0, -5e-324), "a positive number"),
    "not negative": (
        lambda v: require_not_negative(mine=v), (0, 1e308), (-5e-324,), "a finite number, 0 or more",
    ),
    "between": (
        lambda v: require_between(0.25, 7, mine=v), (0.25, 3, 7), (beyond(0.25, BELOW), beyond(7, ABOVE)),
        "0.25 to 7",
    ),
    "up to": (lambda v: require_up_to(7, mine=v), (5e-324, 7), (0, -1, beyond(7, ABOVE)), "above 0, up to 7"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHECKS)
def test_a_number_is_accepted_up_to_its_limits(name: str) -> None:
    check, accepted, refused, expected = CHECKS[name]
    for value in accepted:
        check(value)
    for value in (*refused, math.nan, math.inf, -math.inf, "3", None, 1j):
        with pytest.raises(InvalidArgument) as caught:
            check(value)
        assert (caught.value.where, caught.value.found, caught.value.expected) == (
            "mine",
            repr(value),
            expected,
        )


SPECS: dict[str, tuple[Callable[[Any], Any], tuple[Any, ...], tuple[Any, ...]]] = {
    "segment_s": (lambda v: LiveSpec(segment_s=v), (0.01, 10), (beyond(0.01, BELOW), beyond(10, ABOVE))),
    "--on-air-s": (lambda v: LiveSpec(seconds=v), (None, 1e-9), (0.0, -1.0, math.nan)),
    "seconds": (lambda v: PlaySpec(seconds=v), (None, 1e-9, 86400), (0, -1.0, beyond(86400, ABOVE))),
    "start_s": (lambda v: PlaySpec(start_s=v), (0, 1e9), (-5e-324,)),
    "speed": (lambda v: PlaySpec(speed=v), (1e-9, 100), (0, beyond(100, ABOVE))),
    "density": (lambda v: MeasureSpec(density=v), (None, 1, 999999), (beyond(1, BELOW), 1e6, math.nan)),
    "nmse_db": (lambda v: ReductionSpec(nmse_db=v), (-200, -1e-9), (beyond(-200, BELOW), 0, math.nan)),
    "friction": (lambda v: EncodeSpec(friction=v), (None, 0, 9.0), (-5e-324, math.nan)),
    "damping_n_s_per_m": (lambda v: EncodeSpec(damping_n_s_per_m=v), (None, 0, 9.0), (-5e-324, math.inf)),
    "surface_damping_n_s_per_m": (lambda v: EncodeSpec(surface_damping_n_s_per_m=v), (0, 9.0), (-5e-324,)),
    "nw": (lambda v: EncodeSpec(nw=v), (None, 3, 10), (2, 11)),
    "mapping": (lambda v: EncodeSpec(mapping=v), ("fit", "fill", "crop", 0.05, "2"), (0, "0", -1.0, "nan")),
    "--port": (lambda v: Access(port=v), (0, 65535), (-1, 65536)),
    "--token": (lambda v: Access(token=v), (None, "8letters"), ("7letter", "")),
    "frames": (
        lambda v: EncodeSpec(frames=v), (None, (0, None), (0, 1), (3, 4)),
        ((-1, 2), (2, 2), (3, 2), "ab", (1,), 3),
    ),
    "fit_frames": (lambda v: EncodeSpec(fit_frames=v), (None, (0, 1), (3, None)), ((-1, None), (1, 1))),
}  # fmt: skip


@pytest.mark.parametrize("name", SPECS)
def test_a_spec_is_accepted_up_to_its_limits(name: str) -> None:
    make, accepted, refused = SPECS[name]
    for value in accepted:
        make(value)
    for value in refused:
        with pytest.raises(InvalidArgument) as caught:
            make(value)
        assert caught.value.where.startswith(name.partition(" ")[0]), value


def test_a_public_server_needs_a_token() -> None:
    for host in ("localhost", "127.0.0.1", "127.3.2.1", "::1"):
        Access(host=host)
    for host in ("0.0.0.0", "::", "192.168.1.2", "example.org"):
        with pytest.raises(InvalidArgument, match="which others reach; expected a token"):
            Access(host=host)
        Access(host=host, token="8letters")
        Access(host=host, is_open=True)


def test_the_factor_of_a_mapping() -> None:
    factors = {"fit": None, "fill": None, "crop": 1.0, "0.05": 0.05, 2.5: 2.5}
    assert {mapping: EncodeSpec(mapping=mapping).factor for mapping in factors} == factors


def test_texts_of_frame_ranges() -> None:
    for text, expected in ((None, None), ("3", (3, 4)), ("3:", (3, None)), (":4", (0, 4)), ("2:5", (2, 5))):
        assert frames_of("--frames", text) == expected
    for text in ("5:2", "2:2", "-1:3", "a:b", "1:2:3", "-1"):
        with pytest.raises(InvalidArgument, match="--frames"):
            frames_of("--frames", text)
    require_frames("x", None)
    with pytest.raises(InvalidArgument, match="frames: found"):
        Motion("fox.glb", frames=(2, 1))


def test_numbers_separated_by_commas() -> None:
    assert numbers_of("--x", "1,2.5,-3", (3,), "three") == (1.0, 2.5, -3.0)
    assert numbers_of("--x", "7", (1, 3), "one or three", int) == (7,)
    for text, found in (
        ("1,2", "'1,2'"),
        ("1,2,x", "'1,2,x'"),
        ("", "nothing"),
        (None, "nothing"),
        ("1,2,3,4", "4'"),
    ):
        with pytest.raises(InvalidArgument, match=f"--x: found .*{found}; expected three"):
            numbers_of("--x", text, (3,), "three")


def test_an_address_has_a_host_and_a_port() -> None:
    for text, expected in (
        ("here:1", ("here", 1)), ("127.0.0.1:65535", ("127.0.0.1", 65535)), ("[::1]:9000", ("::1", 9000)),
    ):  # fmt: skip
        assert address(text, "where") == expected
    wrong = ":0 :65536 :-1 :0x9 :".replace(":", "here:").split()
    colons = ["[::1", "[::1:9", "::1]:9", "::1", "::1:9", "[:]:9", "[::1]9", "[::g]:9", "[]:9", "[[::1]]:9"]
    for text in (*wrong, *colons, "here", ":9", "", "a b:9", "a/b:9", "u@h:9"):
        with pytest.raises(InvalidArgument, match="where: found"):
            address(text, "where")
    usual = ("usual", 7)
    for text, expected in (
        ("", usual), ("here", ("here", 7)), (":9", ("usual", 9)), ("here:9", ("here", 9)),
        ("[::1]", ("::1", 7)),
    ):  # fmt: skip
        assert address(text, "where", usual) == expected, text
    for text in ("9", "[::1", "::1", "[::1]9"):
        with pytest.raises(InvalidArgument, match=r"where: found .*; expected a host and a port"):
            address(text, "where", usual)


# -- errors ------------------------------------------------------------------------------------------------


def test_an_error_states_place_cause_and_remedy() -> None:
    """It also survives pickling to another process."""
    for kind, code in (
        (TouchfieldError, 1), (InvalidArgument, 2), (SourceError, 1), (DeviceError, 1), (ForeignFile, 1),
        (TruncatedFile, 1), (CorruptFile, 1), (UnsupportedVersion, 1),
    ):  # fmt: skip
        error = kind("the place", "this", "that", "Do so.")
        back = pickle.loads(pickle.dumps(error))
        for either in (error, back):
            assert str(either) == "the place: found this; expected that. Do so." and type(either) is kind
            assert (either.where, either.found, either.expected, either.hint) == (
                "the place",
                "this",
                "that",
                "Do so.",
            )
            assert either.exit_code == code
    assert isinstance(InvalidArgument("x"), ValueError) and not isinstance(SourceError("x"), ValueError)
    assert str(SourceError("a", "b")) == "a: found b" and str(SourceError("a", hint="c")) == "a. c"
    assert str(SourceError("a", expected="b")) == "a; expected b"
    assert str(SourceError("a\n  b\x1b[2J")) == r"a b\x1b[2J", "in one line, and no screen is rewritten"
    missing = MissingExtra("a picture", "matplotlib", "report")
    assert 'matplotlib is not installed. Install it with: pip install "touchfield[report]"' in str(missing)
    assert missing.exit_code == 2
    with pytest.raises(MissingExtra, match=r"a thing: .* no_such_module_here .*touchfield\[extra\]"):
        import_extra("no_such_module_here", "a thing", "no_such_module_here", "extra")
    assert import_extra("math", "a thing", "math", "extra") is math


def test_an_invalid_argument_in_a_file_is_a_source_error() -> None:
    with pytest.raises(SourceError) as caught, as_source_error("room.toml, shape 3: "):
        raise InvalidArgument("radius_m", "-1", "a positive number", "Mend it.")
    assert str(caught.value) == "room.toml, shape 3: radius_m: found -1; expected a positive number. Mend it."
    with pytest.raises(DeviceError, match="as it is"), as_source_error("room.toml"):
        raise DeviceError("as it is")


def test_short_reasons_of_exceptions() -> None:
    assert reason(TimeoutError(110, "Connection timed out")) == "no answer in time"
    assert reason(FileNotFoundError(2, "No such file", "x")) == "No such file"
    assert reason(ValueError("two\n lines")) == "two lines" and reason(ValueError()) == "ValueError"
    assert reason(ValueError("a" * 300)) == "a" * 120


def test_endings_and_choices() -> None:
    for path in ("a.touch", "b.TOUCH", Path("c.npz"), ".d.npz"):
        require_ending(path, "OUT.touch", "FIELD.npz")
    for path in ("a.vti", "touch", "a.touch.gz", ".npz", "a.", "anpz"):
        with pytest.raises(InvalidArgument) as caught:
            require_ending(path, "OUT.touch", "FIELD.npz", hint="Name it so.")
        assert f"found the ending '{Path(path).suffix}'; expected OUT.touch or FIELD.npz. Name it so." in str(
            caught.value
        )
    require_one_of("it", "a", ("a", "b"))
    for choices, expected in ((("a", "b"), "a or b"), (("a", "b", "c"), "one of a, b, c")):
        with pytest.raises(InvalidArgument, match=f"^it: found 'd'; expected {expected}$"):
            require_one_of("it", "d", choices)


def test_a_field_of_a_request_is_of_its_kind() -> None:
    for spec, wrong in (
        (EncodeSpec, {"device": 3, "nw": 5.5, "stiffness_n_per_m": "much", "oversample": True, "source": {}}),
        (PlaySpec, {"loop": 1, "panel": None, "speed": True, "trajectory": 3}),
        (LiveSpec, {"loop": "yes", "segment_s": "short"}),
    ):  # fmt: skip
        for name, value in wrong.items():
            with pytest.raises(InvalidArgument, match=f"^{name}: found"):
                spec(**{name: value})
    require_kinds(PlaySpec(trajectory="a.csv", seconds=3))  # type: ignore[arg-type]


# -- files and JSON ----------------------------------------------------------------------------------------


def test_a_file_is_read_up_to_its_maximum_size(tmp_path: Path) -> None:
    path = tmp_path / "seven"
    path.write_bytes(b"1234567")
    assert read_bytes(path, 7, "a file") == b"1234567" and plain_size(path, "a file") == 7
    with pytest.raises(SourceError, match="found more than 6 bytes; expected a file up to that"):
        read_bytes(path, 6, "a file")
    for missing, found in ((tmp_path / "none", "no such file"), (tmp_path, "a folder"), ("a\0b", "null")):
        with pytest.raises(SourceError, match=found):
            read_bytes(missing, 9, "a file")
    with pytest.raises(InvalidArgument, match="the file that is read"):
        refuse_overwriting(tmp_path / "." / "seven", tmp_path / "none", path)
    refuse_overwriting(tmp_path / "new", path)
    pipe = io.BytesIO(b"1234567")
    assert (read_up_to(pipe, 3), read_up_to(pipe, 4), read_up_to(pipe, 2)) == (b"123", b"4567", b"")
    assert read_up_to(io.BytesIO(b"12"), 3) == b"12"


def test_a_referenced_file_is_in_the_same_folder(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    (folder / "deep").mkdir(parents=True)
    for name in ("a.stl", "deep/b.stl", "./deep/../a.stl", folder / "c.stl"):
        assert require_in_folder(folder, name, "scene.toml: model") == folder / name
    (folder / "link").symlink_to(tmp_path)
    for name in ("../a.stl", "/etc/passwd", "link/a.stl", tmp_path / "sceneb" / "x"):
        with pytest.raises(SourceError, match=r"scene\.toml: model: found .*; expected a file in the folder"):
            require_in_folder(folder, name, "scene.toml: model")
        assert require_in_folder(folder, name, "scene.toml: model", anywhere=True) == folder / name


def test_whole_numbers_of_json_beyond_18_digits_are_floats() -> None:
    inside, outside = json_of("[123456789012345678, 1234567890123456789]")
    assert (inside, type(inside), type(outside)) == (123456789012345678, int, float)
    assert json_of("1" + "0" * 400) == math.inf


def test_a_json_value_is_accepted_up_to_its_limits(tmp_path: Path) -> None:
    def json_value(value: Any) -> JsonValue:
        return JsonValue(value, "x.json", "$.a[2]")

    for value in (3, 5.0, 7):
        assert json_value(value).bounded_integer(3, 7) == value and isinstance(
            json_value(value).bounded_integer(3, 7), int
        )
    for value in (2, 8, 3.5, True, "3", None, math.nan):
        with pytest.raises(SourceError, match=r"^x\.json: \$\.a\[2\]: found .* an integer from 3 to 7$"):
            json_value(value).bounded_integer(3, 7)
    assert (json_value(0.25).number(0.25, 2), json_value(2).number(0.25, 2), json_value(-1e299).number()) == (
        0.25,
        2.0,
        -1e299,
    )
    for value in (beyond(0.25, BELOW), beyond(2, ABOVE), math.nan):
        with pytest.raises(SourceError, match=r"expected a number from 0\.25 to 2$"):
            json_value(value).number(0.25, 2)
    for value, low, message in ((-1, 0, "a number of at least 0"), (1e300, -math.inf, "a finite number")):
        with pytest.raises(SourceError, match=f"expected {message}$"):
            json_value(value).number(low)
    for value in (True, "1", None, []):
        with pytest.raises(SourceError, match=r"expected a number$"):
            json_value(value).number()
    assert json_value([1]).items(1) == [1] and json_value("a").text(("a", "b")) == "a"
    with pytest.raises(SourceError, match="found an array of 1; expected at least 2"):
        json_value([1]).items(2)
    with pytest.raises(SourceError, match='found "c"; expected one of a, b'):
        json_value("c").text(("a", "b"))
    for value, found in (({}, "an object"), ([], "an array"), (None, "null"), (10**300, "over 300 digits")):
        with pytest.raises(SourceError, match=f"found .*{found}; expected a string"):
            json_value(value).text()
    with pytest.raises(SourceError, match=r"found .{60}\.\.\.; expected a number$"):
        json_value("a" * 70).number()
    document = json_value({"b": 1, "c": [4, 5]})
    assert document.get("d") is None and document.at("d", 9).value == 9
    inner = [(each.value, each.location) for each in document.at("c").elements()]
    assert inner == [(4, "$.a[2].c[0]"), (5, "$.a[2].c[1]")]
    document.only(("b", "c"))
    with pytest.raises(SourceError, match=r"\$\.a\[2\]\.c: found a key that is not known; .* one of b, d"):
        document.only(("b", "d"))
    with pytest.raises(SourceError, match=r"\$\.a\[2\]: found no 'd'"):
        document.at("d")
    for data in (b"{", b"\xff", b"[NaN]", b"[" * 100000):
        with pytest.raises(SourceError, match=r"where: found (no JSON|JSON nested too deeply)"):
            parsed(data, "where", "a file")
    (tmp_path / "bom.json").write_bytes(b"\xef\xbb\xbf[1]")
    assert read_json(tmp_path / "bom.json", 9, "a file").value == [1]


# -- workers -----------------------------------------------------------------------------------------------


def test_the_number_of_threads_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TOUCHFIELD_THREADS", raising=False)
    default = worker_count()
    for text, count in (
        ("1", 1),
        ("37", 37),
        ("0", default),
        ("", default),
        ("-2", default),
        ("many", default),
    ):
        monkeypatch.setenv("TOUCHFIELD_THREADS", text)
        assert worker_count() == count, text


@pytest.mark.parametrize("threads", ["1", "3"])
def test_each_number_is_processed_once_in_order(monkeypatch: pytest.MonkeyPatch, threads: str) -> None:
    def work(start: int, end: int, more: int) -> list[int]:
        return [n + more for n in range(start, end)]

    monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
    for count in (0, 1, 2, 11, 12, 13, 100):
        for chunk in (1, 5, 200):
            parts = for_chunks(work, count, 7, chunk=chunk)
            assert [n for part in parts for n in part] == list(range(7, count + 7)), (count, chunk)
            assert len(parts) <= max(1, count // chunk)

    def fails(start: int, end: int) -> None:
        if start <= 5 < end:
            raise KeyError(5)

    with pytest.raises(KeyError):
        for_chunks(fails, 20)


def test_processes_are_at_most_1024(monkeypatch: pytest.MonkeyPatch) -> None:
    pools: list[tuple[Any, ...]] = []

    class Pool:
        def __init__(self, *args: Any) -> None:
            pools.append(args)

        def __enter__(self) -> Pool:
            return self

        def __exit__(self, *_: object) -> None:
            pass

    monkeypatch.setattr("touchfield.compute.executor_kinds.ProcessPoolExecutor", Pool)
    monkeypatch.setenv("TOUCHFIELD_THREADS", "7")
    for count, threads in ((1, 7), (3, 2), (1024, 1)):
        with executor_of(f"processes:{count}") as pool:
            assert isinstance(pool, Pool)
        workers, _, _, threads_of_worker = pools.pop()
        assert (workers, threads_of_worker) == (count, (threads,)), "the threads of the machine are shared"
    for executor in ("processes:0", "processes:1025", "processes:", "processes", "dask:", "threads:3", "3"):
        with pytest.raises(InvalidArgument, match="--workers: found"), executor_of(executor):
            pass
    with executor_of(None) as nothing:
        assert nothing is None and not pools
