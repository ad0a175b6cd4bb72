"""The main job, end to end: a scene becomes a ``.touch`` file and comes back.

source -> device filter (M) -> medium -> coder -> segments -> file      prepare, encode
file -> segments -> decoder -> medium                                   open_stream
medium against its source                                               compare
medium before and after each haptic filter                              filter_report
medium, device and filters in bits                                      measure_medium
"""

from touchfield.job.compare import Comparison, compare
from touchfield.job.encode import Encoded, encode
from touchfield.job.filtering import FilterReport, draw_filtered, filter_report
from touchfield.job.measure import MeasureSpec, measure_medium
from touchfield.job.measurement import Measurement
from touchfield.job.prepare import Prepared, prepare
from touchfield.job.spec import EncodeSpec
from touchfield.job.stream import OpenStream, open_stream, write_field
from touchfield.job.warm import warm_up

__all__ = [
    "Comparison",
    "EncodeSpec",
    "Encoded",
    "FilterReport",
    "MeasureSpec",
    "Measurement",
    "OpenStream",
    "Prepared",
    "compare",
    "draw_filtered",
    "encode",
    "filter_report",
    "measure_medium",
    "open_stream",
    "prepare",
    "warm_up",
    "write_field",
]
