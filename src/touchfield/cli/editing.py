"""Commands that make a new file from a stored medium (paper section 4): `edit`, `splice`, `resample`, `lod`,
`partition`, `texture`, `deform`; and `reduce` (section 6.1)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from touchfield.cli.main import Options, command
from touchfield.cli.options import (
    CODER,
    FORCE_ROWS,
    coder_spec,
    fields_of,
    frames_of,
    numbers_of,
    refuse_unused,
    rows_of,
    values_of,
    with_options,
)
from touchfield.cli.output import Answer, check_results, progress, show_notes, show_rows
from touchfield.errors import InvalidArgument
from touchfield.filters.registry import length_m
from touchfield.pipeline.spec import Motion, ReductionSpec
from touchfield.sources.recordings.recording import STANDARD_GRAVITY_M_S2
from touchfield.tasks import editing
from touchfield.tasks.timeline import edit_timeline

if TYPE_CHECKING:
    from touchfield.render.material import Material

RUBBED = tuple(row for row in FORCE_ROWS if row.name != "vibration")

Medium = Annotated[
    str, typer.Argument(help="A .touch file, or a stored field (.npz, .vti).", metavar="MEDIUM")
]
Out = Annotated[Path, typer.Argument(help="OUT.touch, or a field: FIELD.npz, FIELD.vti.")]
Kernel = Annotated[str, typer.Option(help="Of the resampler: spline, box, sinc, or trilinear for none.")]


DEFAULT_RELAX_S: Final = 0.05
_COUNTS = "NX,NY,NZ, such as 64,64,32"


@command(
    "Make",
    'edit room.touch soft.touch --region "ball:0mm,10mm,0mm,15mm" --operator gain:0.5',
    "edit both.mp4 edited.mp4 --timeline both.edits.json",
)
@with_options(CODER)
def edit(
    options: Options,
    medium: Annotated[
        str, typer.Argument(help="A .touch file, or a stored field (.npz, .vti); with --timeline a movie.")
    ],
    out: Annotated[
        Path, typer.Argument(help="OUT.touch, or a field: FIELD.npz, FIELD.vti; with --timeline a movie.")
    ],
    operator: Annotated[
        list[str] | None,
        typer.Option(
            help="gain:2, erase, limit:1.5, move:DX,DY,DZ, turn:AX,AY,AZ,DEG[,X,Y,Z], "
            "mirror:NX,NY,NZ[,X,Y,Z]; "
            "over:, add:, max: or replace:FILE; or a filter, gaussian:sigma=2mm. May be repeated."
        ),
    ] = None,
    region: Annotated[
        str,
        "everywhere, box:X,Y,Z,X,Y,Z, ball:X,Y,Z,R, half-space:NX,NY,NZ,X,Y,Z (lengths as 2mm) or "
        "force:LOW..HIGH (N); with | (or), & (and), ~ (not).",
    ] = "everywhere",
    feather: Annotated[str, "Width of the transition outside the region, such as 2mm."] = "0mm",
    frames: Annotated[str | None, "Frames to edit, START:STOP; default: all."] = None,
    timeline: Annotated[
        Path | None, "Edits that the page of a movie saved (.json): strength by time, mute, offset."
    ] = None,
) -> Answer:
    """Change MEDIUM within a region, or over time; the rest stays as it was."""
    if timeline is not None:
        regional = {"region": (region, "everywhere"), "feather": (feather, "0mm"), "frames": (frames, None)}
        refuse_unused({"operator": (operator, None), **regional}, "with --timeline")
        with progress("edit") as report:
            edited = edit_timeline(medium, out, timeline, coder_spec(options), report)
        return Answer(edited.summary(), str(out), edited.notes)
    if frames is not None and ":" not in frames:
        raise InvalidArgument("--frames", repr(frames), "START:STOP, such as 0:24")
    span = frames_of("--frames", frames)
    with progress("edit") as report:
        done = editing.edit(
            medium,
            out,
            region,
            operator or (),
            length_m(feather, "--feather"),
            span,
            coder_spec(options),
            report,
        )
    return Answer(done.summary(), str(done.path), done.notes)


@command("Make", "splice first.touch second.touch both.touch")
@with_options(RUBBED, CODER)
def splice(
    options: Options,
    media: Annotated[list[str], "FILE or FILE@START:STOP, in order; the last one is OUT.touch."],
    fade_s: Annotated[float, "Seconds in which one fades into the next."] = 0.0,
    kernel: Kernel = "spline",
) -> Answer:
    """Join media one after the other, all on the lattice and at the rate of the first."""
    if len(media) < 2:
        raise InvalidArgument(
            "touchfield splice", f"{len(media)} file", "media to join, and OUT.touch behind them"
        )
    with progress("splice") as report:
        done = editing.splice(media[:-1], Path(media[-1]), fade_s, kernel, coder_spec(options), report)
    return Answer(done.summary(), str(done.path), done.notes)


@command("Make", "resample room.touch small.touch --nw 5", "resample room.touch slow.touch --rate-hz 15")
@with_options(CODER)
def resample(
    options: Options,
    medium: Medium,
    out: Out,
    nw: Annotated[int | None, "2^nw samples per axis over the same box."] = None,
    shape: Annotated[str | None, "NX,NY,NZ samples over the same box."] = None,
    spacing: Annotated[str | None, "Distance between samples, such as 1.5mm."] = None,
    rate_hz: Annotated[float | None, "Frames a second."] = None,
    kernel: Kernel = "spline",
) -> Answer:
    """Resample MEDIUM to another lattice or rate, and report the loss at a receiver."""
    samples = None if shape is None else numbers_of("--shape", shape, (3,), _COUNTS, int)
    lattice = nw, samples, None if spacing is None else length_m(spacing, "--spacing")
    with progress("resample") as report:
        done = editing.resample_file(medium, out, lattice, rate_hz, kernel, coder_spec(options), report)
    return Answer(done.summary(), str(done.path), done.notes)


@command("Make", "lod room.touch levels --max-bytes 20000")
@with_options(CODER)
def lod(
    options: Options,
    medium: Medium,
    folder: Annotated[
        Path | None,
        typer.Argument(
            help="Folder for level-0.touch, ..., or OUT.zarr with all levels; without it, figures only."
        ),
    ] = None,
    levels: Annotated[int | None, "How often the lattice is halved; default: to 8 samples."] = None,
    max_bytes: Annotated[int | None, "Name the finest level that takes no more."] = None,
) -> Answer:
    """Make levels of detail of MEDIUM, each a file with its bytes and its error."""
    with progress("lod") as report:
        done = editing.levels_of_detail(medium, folder, levels, max_bytes, coder_spec(options), report)

    def print_text() -> None:
        show_rows(done.figures["levels"], f"levels of detail of {medium}")
        show_notes(done.notes)

    return Answer(done.summary(), "", done.notes, print_text=print_text)


@command("Make", "partition room.touch --depth 1 --penalty-bits 100")
def partition(
    medium: Medium,
    depth: Annotated[int, "The device has 2^-depth of the lattice's samples along each axis."] = 2,
    penalty_bits: Annotated[float, "lambda: bits a frame that another box must save."] = 1000.0,
    quantiser: Annotated[str, "Q of the losses."] = "weber:0.25/ico1",
) -> Answer:
    """Divide the workspace of MEDIUM into boxes that each fill a coarse device, with the least loss."""
    from touchfield.pipeline.partition import partition_workspace
    from touchfield.tasks.matching import read_medium

    source = read_medium(medium).medium
    if not 0 <= depth <= 7:
        raise InvalidArgument("--depth", f"{depth}", "0 to 7")
    x, y, z = (max(1, n >> depth) for n in source.grid.shape)
    with progress("partition") as report:
        done = partition_workspace(source, (x, y, z), penalty_bits, quantiser, report)
    rows = []
    for box in done.boxes:
        low, high = ((1e3 * corner).round(6).tolist() for corner in done.grid(box).box_m)
        rows.append({"depth": box.depth, "low_mm": low, "high_mm": high, "lost_bits": box.loss_bits})
    figures = {name: value for name, value in done.summary().items() if name != "boxes"}
    return Answer({"box_count": len(rows), **figures, "boxes": rows}, medium)


@command(
    "Make",
    "texture drag-50.wav drag-100.wav -o oak.json --speed-m-s 0.05,0.1 --force-n 1 --plot oak.png",
    "texture oak.json --into table.touch -o oak-table.touch",
    "play oak-table.touch --offline --plot forces.png",
)
def texture(
    sources: Annotated[list[Path], "Recordings (.wav, .csv, .txt), models (.xml), or tables (.json)."],
    out: Annotated[Path, typer.Option("-o", "--out", help="Table to write, .json; with --into OUT.touch.")],
    speed_m_s: Annotated[str | None, "Speed of each recording, or one for all: 0.05,0.1."] = None,
    force_n: Annotated[str | None, "Force of each recording, or one for all: 1."] = None,
    name: Annotated[str | None, "Name of the material; default: that of the table."] = None,
    friction: Annotated[float | None, "mu of the material; default: the medium's."] = None,
    full_scale_m_s2: Annotated[float, "Of a .wav: acceleration of its full scale."] = STANDARD_GRAVITY_M_S2,
    into: Annotated[Path | None, "Stream that is written anew with the materials in it."] = None,
    plot: Annotated[Path | None, "PNG to draw: the spectra, and what a hand feels."] = None,
) -> Answer:
    """Make a material of recorded accelerations; put materials into a stream."""
    from touchfield.render.material import read_materials, write_table
    from touchfield.sources.recordings.penn_hatt import read_texture_models
    from touchfield.tasks.texture import (
        merge_materials,
        store_materials,
        texture_of_files,
        texture_of_models,
    )

    check_results((*sources, into), out, plot=plot)
    tables = [read_materials(path) for path in sources if path.suffix.lower() == ".json"]
    models = [path for path in sources if path.suffix.lower() == ".xml"]
    tables += [(texture_of_models(read_texture_models(path)),) for path in models]
    recorded = [path for path in sources if path.suffix.lower() not in (".json", ".xml")]
    notes: tuple[str, ...] = ()
    if not any(path.suffix.lower() == ".wav" for path in recorded):
        refuse_unused({"full-scale-m-s2": (full_scale_m_s2, STANDARD_GRAVITY_M_S2)}, "without a .wav")
    if recorded:
        count = len(recorded)
        expected = f"one number, or one for each of {count} recordings: 0.05,0.1"
        named = ("--speed-m-s", speed_m_s), ("--force-n", force_n)
        given = [
            None if text is None else (count * numbers_of(option, text, (1, count), expected))[:count]
            for option, text in named  # one number is that of all
        ]
        speeds, forces = given
        material, notes = texture_of_files(
            recorded, speeds, forces, name or out.stem, friction, full_scale_m_s2
        )
        tables.append((material,))
    elif speed_m_s or force_n or name or friction is not None:
        raise InvalidArgument(
            "--speed-m-s, --force-n, --name and --friction are those of recordings; a table has its own"
        )
    materials = merge_materials(*tables)
    if into is None:
        write_table(out, materials)
    else:
        store_materials(into, materials, out)
    if plot is not None:
        _draw(plot, materials)
    names = [material.name for material in materials]
    values = {"file": str(out), "file_bytes": out.stat().st_size, "materials": names}
    return Answer(values, str(out), notes)


def _draw(path: Path, materials: tuple[Material, ...]) -> None:
    from touchfield.perception.human import vibration_threshold
    from touchfield.perception.vibrotactile import BANDS_HZ
    from touchfield.viewer.plots import TextureCurve, draw_textures

    curves = [
        TextureCurve(material.name, speed, force, material.levels_n[i, j])
        for material in materials
        for i, speed in enumerate(material.speeds_m_s)
        for j, force in enumerate(material.forces_n)
    ]
    draw_textures(path, BANDS_HZ, curves, 1e-3 * vibration_threshold().force_rms_mn(BANDS_HZ))


@command(
    "Make",
    "encode fox.glb fox.touch --frames 60:61 --representation voxel",
    "deform fox.touch fox.glb -o walk.npz --frames 52:68 --rest-frame 60",
    "play fox.touch --deformation walk.npz --offline --seconds 2",
    "deform fox.touch -o soft.npz --yield-m-per-n 0.002 --relax-s 0.1",
)
@with_options(rows_of(Motion))
def deform(
    options: Options,
    stream: Annotated[Path, "Stream of voxels, .touch."],
    model: Annotated[Path | None, typer.Argument(help="Animated glTF that STREAM shows at rest.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Deformation to write, .npz.")] = Path(
        "deformation.npz"
    ),
    controls: Annotated[int, "Control points along each axis, 4 to 32."] = 8,
    yield_m_per_n: Annotated[float, "Metres that the medium gives way for a newton."] = 0.0,
    relax_s: Annotated[float, "Time constant with which it does, seconds."] = DEFAULT_RELAX_S,
) -> Answer:
    """Bend STREAM at the receiver: by the motion of a model, or under the finger."""
    from touchfield.tasks.deformation import tracks_of

    check_results((stream, model), out)
    if model is None:
        refuse_unused(values_of(options, rows_of(Motion)), "without MODEL")
    if not yield_m_per_n:
        refuse_unused({"relax-s": (relax_s, DEFAULT_RELAX_S)}, "without --yield-m-per-n")
    moved = fields_of(Motion, options) | {"frames": frames_of("--frames", options["frames"])}
    motion = Motion(model, **moved) if model else None
    with progress("deform") as report:
        done = tracks_of(
            stream,
            out,
            motion,
            controls=controls,
            compliance_m_per_n=yield_m_per_n,
            relax_s=relax_s,
            report=report,
        )
    return Answer(done.summary(), str(out))


@command(
    "Study",
    "reduce fox.touch",
    "reduce ground.touch --cull shell.touch --mode lossless --plot reduced.png",
    "reduce fox.touch few-modes.touch --rank 20 --trace log.csv",
)
@with_options(rows_of(ReductionSpec), CODER)
def reduce(
    options: Options,
    medium: Medium,
    out: Annotated[Path | None, typer.Argument(help="File to write from the modes that were used.")] = None,
    cull: Annotated[
        Path | None,
        "OUT.touch without what is proved out of the hand's reach: of a smooth solid, not of a box.",
    ] = None,
    plot: Annotated[Path | None, "PNG to draw: the error by modes, and a slice of what is left out."] = None,
) -> Answer:
    """Reduce MEDIUM to a few modes; report degrees of freedom, their entropy, and unreachable samples."""
    from touchfield.tasks.reduction import reduce_medium

    check_results((medium,), out, cull, plot=plot)
    spec = ReductionSpec(**fields_of(ReductionSpec, options))
    with progress("reduce") as report:
        done = reduce_medium(medium, out, cull, spec, coder_spec(options), report)
    picture = () if plot is None else (f"the picture is {plot}",)
    if plot is not None:
        done.draw(plot)
    return Answer(
        done.summary(), medium, (*done.notes, *picture), {"held_out": "frames that were not learnt"}
    )
