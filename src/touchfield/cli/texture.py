"""The command of materials: texture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchfield.cli.app import Json, command
from touchfield.cli.show import check_picture, show
from touchfield.errors import InvalidArgument
from touchfield.sources.recording import STANDARD_GRAVITY_M_S2

if TYPE_CHECKING:
    from touchfield.render.material import Material


@command(
    "Make",
    "texture drag-50.wav drag-100.wav -o oak.json --speed-m-s 0.05,0.1 --force-n 1 --plot oak.png",
    "texture oak.json --into table.touch -o oak-table.touch",
    "play oak-table.touch --offline --plot forces.png",
)
def texture(
    sources: Annotated[list[Path], typer.Argument(help="Recordings (.wav, .csv), or tables (.json).")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Table to write, .json; with --into OUT.touch.")],
    speed_m_s: Annotated[str | None, typer.Option(help="Speed of each recording, or one for all: 0.05,0.1.")] = None,
    force_n: Annotated[str | None, typer.Option(help="Force of each recording, or one for all: 1.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the material; default: that of the table.")] = None,
    friction: Annotated[float | None, typer.Option(help="mu of the material; default: the medium's.")] = None,
    full_scale_m_s2: Annotated[
        float, typer.Option(help="Of a .wav: acceleration of its full scale.")
    ] = STANDARD_GRAVITY_M_S2,
    into: Annotated[Path | None, typer.Option(help="Stream that is written anew with the materials in it.")] = None,
    plot: Annotated[Path | None, typer.Option(help="PNG to draw: the spectra, and what a hand feels.")] = None,
    as_json: Json = False,
) -> None:
    """Make a material of recorded accelerations; put materials into a stream."""
    from touchfield.job.texture import merged, store_materials, texture_of
    from touchfield.render.material import read_materials, write_table
    from touchfield.sources.recording import read_recording

    for source in (*sources, *([into] if into else [])):
        check_picture(source, out)
        check_picture(source, plot)
    tables = [read_materials(path) for path in sources if path.suffix.lower() == ".json"]
    recorded = [path for path in sources if path.suffix.lower() != ".json"]
    if recorded:
        speeds, forces = (_numbers(*pair, len(recorded)) for pair in (("speed-m-s", speed_m_s), ("force-n", force_n)))
        recordings = [read_recording(path, full_scale_m_s2) for path in recorded]
        tables.append((texture_of(recordings, speeds, forces, name or out.stem, friction),))
    elif speed_m_s or force_n or name or friction is not None:
        raise InvalidArgument(
            "--speed-m-s, --force-n, --name and --friction are those of recordings; a table has its own"
        )
    materials = merged(*tables)
    if into is None:
        write_table(out, materials)
    else:
        store_materials(into, materials, out)
    if plot is not None:
        _draw(plot, materials)
    show(
        {"file": str(out), "file_bytes": out.stat().st_size, "materials": [m.name for m in materials]},
        str(out),
        as_json,
    )


def _numbers(option: str, text: str | None, count: int) -> list[float]:
    """One number for each recording."""
    try:
        values = [float(part) for part in (text or "").split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, count):
        found = "nothing" if text is None else repr(text)
        raise InvalidArgument(f"--{option}", found, f"one number, or one for each of {count} recordings: 0.05,0.1")
    return values * (count if len(values) == 1 else 1)


def _draw(path: Path, materials: tuple[Material, ...]) -> None:
    from touchfield.perception.human import vibration_threshold
    from touchfield.perception.vibrotactile import BANDS_HZ
    from touchfield.viewer.plots import draw_textures

    rows = {
        f"{one.name}, {1e3 * speed:g} mm/s, {force:g} N": one.levels_n[i, j]
        for one in materials
        for i, speed in enumerate(one.speeds_m_s)
        for j, force in enumerate(one.forces_n)
    }
    draw_textures(path, BANDS_HZ, rows, 1e-3 * vibration_threshold().force_rms_mn(BANDS_HZ))
