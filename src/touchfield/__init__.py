"""touchfield: passive haptic media. Touch recorded, stored, processed and broadcast like sound and pictures.
A medium is a force field over time: the package makes it from a scene, codes it to a ``.touch`` file, and
plays it on a haptic device.

    import touchfield as tf

    tf.encode("sample:terrain", "terrain.touch")
    with tf.open_stream("terrain.touch") as stream:
        print(stream.medium[0].sample_n([0.0, 0.0, 0.0]), "N")
    tf.compare("sample:terrain", "terrain.touch").draw("terrain.png")

The names in ``__all__`` are the ones that most programs need. Everything else is reached through its package,
which is imported when it is first used: ``tf.medium`` (grids, fields, media), ``tf.sources``, ``tf.devices``,
``tf.perception``, ``tf.filters``, ``tf.measure``, ``tf.reduction``, ``tf.codec``, ``tf.container``,
``tf.pipeline`` (figure 4 of the paper), ``tf.render`` (the receiver), ``tf.viewer``, ``tf.network``,
``tf.exchange``, ``tf.guidance``, ``tf.study``, ``tf.tasks`` (what each command does), ``tf.cli``. After
Moustakas and Lalos,
*An information-theoretic treatment of passive haptic media*.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes
from touchfield._version import __version__
from touchfield.errors import TouchfieldError
from touchfield.hooks import register

if TYPE_CHECKING:
    from touchfield import (
        cli as cli,
        codec as codec,
        compute as compute,
        container as container,
        exchange as exchange,
        filters as filters,
        guidance as guidance,
        maps as maps,
        measure as measure,
        medium as medium,
        network as network,
        perception as perception,
        pipeline as pipeline,
        reduction as reduction,
        render as render,
        sources as sources,
        study as study,
        tasks as tasks,
        viewer as viewer,
    )
    from touchfield.devices import device, devices
    from touchfield.medium import ForceField, Grid, HapticMedium
    from touchfield.network.opening import open_stream
    from touchfield.pipeline import EncodeSpec, compare, decode, encode, prepare, write_field
    from touchfield.render.player import Player
    from touchfield.render.sampler import FieldSampler
    from touchfield.render.ticked_player import TickedPlayer
    from touchfield.sources.registry import open_source
    from touchfield.tasks.plan import plan
    from touchfield.tasks.play import play
    from touchfield.tasks.view import view

__all__ = [
    "EncodeSpec",
    "FieldSampler",
    "ForceField",
    "Grid",
    "HapticMedium",
    "Player",
    "TickedPlayer",
    "TouchfieldError",
    "__version__",
    "compare",
    "decode",
    "device",
    "devices",
    "encode",
    "open_source",
    "open_stream",
    "plan",
    "play",
    "prepare",
    "view",
    "write_field",
]

register(
    draw_medium="touchfield.tasks.view:draw_medium",
    filter_by_text="touchfield.filters.registry:filter_by_text",
    view="touchfield.tasks.view:view",
)

_PACKAGES = frozenset(
    (
        *(
            "cli",
            "codec",
            "compute",
            "container",
            "devices",
            "exchange",
            "filters",
            "guidance",
            "maps",
            "measure",
            "medium",
            "network",
        ),
        *("perception", "pipeline", "reduction", "render", "sources", "study", "tasks", "viewer"),
    )
)
_MODULES = {
    "devices": ("device",),
    "medium": ("ForceField", "Grid", "HapticMedium"),
    "network.opening": ("open_stream",),
    "pipeline": (
        "EncodeSpec",
        "compare",
        "decode",
        "encode",
        "prepare",
        "write_field",
    ),
    "render.player": ("Player",),
    "render.sampler": ("FieldSampler",),
    "render.ticked_player": ("TickedPlayer",),
    "sources.registry": ("open_source",),
    "tasks.plan": ("plan",),
    "tasks.play": ("play",),
    "tasks.view": ("view",),
}
__getattr__ = lazy_attributes(__name__, _MODULES)  # so that `import touchfield` stays fast


def __dir__() -> list[str]:
    return sorted({*__all__, *_PACKAGES})
