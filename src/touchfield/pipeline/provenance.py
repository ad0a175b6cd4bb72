"""Builds the provenance that a ``.touch`` file stores: the version of touchfield, the source and the options
it was made with."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from touchfield._version import __version__
from touchfield.pipeline.source import Source, is_stream
from touchfield.pipeline.stream import FILTERED

if TYPE_CHECKING:
    from touchfield.pipeline.preparation import Prepared


def file_provenance(source: Source | ArrayLike, prepared: Prepared) -> dict[str, str]:
    """The provenance of a file: version, source and spec; of a source that is a stream also its own."""
    name = str(source) if isinstance(source, str | Path) else "scene"
    thin = "thicken" if prepared.is_thickened else "keep"  # what was done: other files do not change
    spec = replace(prepared.spec, thin=thin).to_json(prepared.has_law)
    shown_name = os.fsencode(Path(name).name).decode("utf-8", "replace")  # a name may be any bytes
    shown_name = re.sub(r"[\0-\x1f\x7f-\x9f]", "\N{REPLACEMENT CHARACTER}", shown_name)
    provenance = {"touchfield": __version__, "source": shown_name[:255], "spec": spec}
    if prepared.reference != FILTERED:
        provenance["reference"] = prepared.reference
    source_provenance = (prepared.objects or prepared.medium).provenance
    for key in ("source", "spec") if is_stream(source) else ():
        if key in source_provenance:
            provenance[f"source.{key}"] = source_provenance[key]
    return provenance
