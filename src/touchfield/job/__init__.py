"""The main job, end to end: a scene becomes a ``.touch`` file and comes back.

source -> device filter (M) -> medium -> coder -> segments -> file      prepare, encode
file -> segments -> decoder -> medium                                   open_stream
medium against its source, and as a hand feels it                        compare
medium -> a picture of where the scene lies in the workspace            draw_preview
medium before and after each haptic filter                              filter_report
medium, device and filters in bits                                      measure_medium
medium -> workspace in boxes that each fill the device                  partition_workspace
scene -> a file of a given size or error                                encode_to_target
scene -> a huge lattice, as tiles of a zarr store                        encode_tiles
scene, budget -> lattice and settings that spend it best                plan
"""

from touchfield.job.compare import Comparison, compare, filter_report
from touchfield.job.encode import Encoded, encode
from touchfield.job.mapping import partition_workspace
from touchfield.job.measure import Measurement, MeasureSpec, measure_medium
from touchfield.job.plan import Budget, Plan, PlanGrid, Trial, parse_budget, plan
from touchfield.job.prepare import Prepared, prepare
from touchfield.job.rate_control import Target, encode_to_target
from touchfield.job.setup import warm_up
from touchfield.job.spec import EncodeSpec
from touchfield.job.tiles import Tiled, encode_tiles
from touchfield.job.view import draw_preview
from touchfield.stream.opened import OpenStream, open_stream, write_field

__all__ = [
    "Budget",
    "Comparison",
    "EncodeSpec",
    "Encoded",
    "MeasureSpec",
    "Measurement",
    "OpenStream",
    "Plan",
    "PlanGrid",
    "Prepared",
    "Target",
    "Tiled",
    "Trial",
    "compare",
    "draw_preview",
    "encode",
    "encode_tiles",
    "encode_to_target",
    "filter_report",
    "measure_medium",
    "open_stream",
    "parse_budget",
    "partition_workspace",
    "plan",
    "prepare",
    "warm_up",
    "write_field",
]
