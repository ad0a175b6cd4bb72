"""What a file states about its origin: source and spec, and the field that its error bound refers to."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from touchfield._version import __version__
from touchfield.filters.device_spec import same_lattice
from touchfield.pipeline.decoding import FILTERED
from touchfield.pipeline.source import Source, is_stream
from touchfield.pipeline.spec import SOURCE_FORCES, EncodeSpec
from touchfield.sources.scene import Scene

if TYPE_CHECKING:
    from touchfield.pipeline.placement import Mapping
    from touchfield.pipeline.preparation import Prepared


def bound_reference(scene: Scene, mapping: Mapping | None, spec: EncodeSpec) -> str:
    """The field that an error bound refers to: the source's own forces if nothing changed them."""
    stored = scene.stored
    if stored is None or spec.chain:
        return FILTERED
    keeps_forces = mapping is None or same_lattice(mapping.placement.to_scene(mapping.grid), stored.grid)
    return SOURCE_FORCES if keeps_forces else FILTERED


def file_provenance(source: Source | ArrayLike, prepared: Prepared) -> dict[str, str]:
    """The provenance of a file: version, source and spec; of a source that is a stream also its own."""
    name = str(source) if isinstance(source, str | Path) else "scene"
    spec = prepared.spec.to_json(prepared.has_law)
    shown_name = os.fsencode(Path(name).name).decode("utf-8", "replace")  # a name may be any bytes
    shown_name = re.sub(r"[\0-\x1f\x7f-\x9f]", "\N{REPLACEMENT CHARACTER}", shown_name)
    provenance = {"touchfield": __version__, "source": shown_name[:255], "spec": spec}
    if prepared.reference != FILTERED:
        provenance["reference"] = prepared.reference
    source_provenance = (prepared.scene or prepared.medium).provenance
    for key in ("source", "spec") if is_stream(source) else ():
        if key in source_provenance:
            provenance[f"source.{key}"] = source_provenance[key]
    return provenance
