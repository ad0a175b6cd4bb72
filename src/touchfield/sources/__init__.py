"""Opens scenes, from which force fields are computed on any lattice (meshes, depth sequences, videos,
simulated bodies and others), and defines how a surface pushes a hand (*force laws*).

`registry` opens scenes, `laws` defines the force laws.
"""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.sources.options import SourceOptions
    from touchfield.sources.registry import open_source

__all__ = ["SourceOptions", "open_source"]

__getattr__ = lazy_attributes(__name__, {"options": ("SourceOptions",), "registry": ("open_source",)})
