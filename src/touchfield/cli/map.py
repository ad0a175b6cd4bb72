"""The command `map`: a tactile map of geographic data or of a drawing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchfield.cli.main import command
from touchfield.cli.options import numbers_of
from touchfield.cli.output import Answer, check_results, progress


@command(
    "Make",
    "map sample:park park.touch --plot park.png",
    "map crossing.osm.pbf crossing.touch --device graphiti",
    "map park.geojson park.touch --box 10.06,48.13,10.08,48.14 --language de",
    "map plan.svg plan.touch --no-labels --svg swell.svg --stl plate.stl",
    "map hills.osm.pbf hills.touch --relief dem.tif --svg swell.svg",
    name="map",
)
def make_map_command(
    source: Annotated[
        Path,
        typer.Argument(
            help="MAP.geojson, .osm or .osm.pbf (OpenStreetMap), a drawing, .svg, or sample:park."
        ),
    ],
    out: Annotated[
        Path, typer.Argument(help="The .touch file; pages of the legend are OUT.legend-1.touch and so on.")
    ],
    device: Annotated[
        str, "A pin display or a point device: a profile's name, or its TOML file."
    ] = "graphiti",
    box: Annotated[
        str | None, "The part to draw: WEST,SOUTH,EAST,NORTH, degrees; of a drawing LEFT,TOP,RIGHT,BOTTOM."
    ] = None,
    level: Annotated[str | None, "The floor of a building."] = None,
    language: Annotated[str, "Language of the Braille, such as de, or a table of liblouis."] = "en",
    zooms: Annotated[
        int | None, "Zoom levels for a display; default: until every feature and name is shown, at most 4."
    ] = None,
    relief: Annotated[
        Path | None, "Heights of the land beneath, such as a GeoTIFF in degrees: contour lines, or height."
    ] = None,
    interval_m: Annotated[
        float | None, "Metres in height from a contour line to the next; default: at most 6 lines on the map."
    ] = None,
    no_labels: Annotated[bool, typer.Option("--no-labels", help="Draw no Braille.")] = False,
    svg: Annotated[Path | None, "Also write a drawing for swell paper, .svg."] = None,
    stl: Annotated[Path | None, "Also write a plate for 3-D printers, .stl."] = None,
    plot: Annotated[Path | None, "PNG to draw: the pins by class, and the legend."] = None,
) -> Answer:
    """Make a tactile map: symbols that a finger can tell apart, Braille labels and a legend."""
    from touchfield.tasks.map import MapSpec, make_map

    sources = (source,) if relief is None else (source, relief)
    check_results(sources, out, svg, stl, plot=plot)
    corners = None
    if box is not None:
        corners = numbers_of("--box", box, (4,), "four numbers, such as 10.06,48.13,10.08,48.14")
    spec = MapSpec(device, corners, level, language, not no_labels, zooms, relief, interval_m)
    with progress("map"):
        made = make_map(source, out, spec, svg=svg, stl=stl)
    if plot is not None:
        made.draw(plot)
    return Answer(made.summary(), str(out), made.notes, {"legend": "legend"})
