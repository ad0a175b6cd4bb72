"""Bounds what the instances in a file expand to, before a library expands them.

COLLADA and 3MF define objects once and use them many times, also within others: 40 definitions of a hundred
bytes that each use the next one twice are 10^12 objects.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Final

from touchfield.errors import SourceError

ROOT: Final = ""
"""Name of what is shown: the scene, or the build."""
_MAX_EXPANDED: Final = 1 << 28  # bytes of the text of all instances, or those of the file
_MAX_DEPTH: Final = 64


class Definitions:
    """The definitions of a file: the length of each, and those that it uses.

    where : str; The file, for messages.
    max_size : int; What the root may expand to, in the unit of `sizes`; that of the file if it is longer.
    unit : str; Name of that unit in messages.

    Attributes
    ----------
    sizes : dict of str to int; Bytes of the text of each definition, without those that it uses.
    uses : dict of str to list of str; Names of the definitions that each uses, once for each instance.
    """

    def __init__(self, where: str, max_size: int = _MAX_EXPANDED, unit: str = "bytes") -> None:
        self._where, self._max_size, self._unit = where, max_size, unit
        self.sizes = defaultdict[str, int](int)
        self.uses = defaultdict[str, list[str]](list)

    def require_bounded(self, file_bytes: int) -> None:
        """Raise `SourceError` if a definition uses itself, is too deep, or the root expands to too much."""
        totals, depths, opened = dict[str, int](), dict[str, int](), set[str]()
        pending = [ROOT]
        while pending:
            name = pending[-1]
            used = self.uses.get(name, [])
            if name in opened:
                pending.pop()
                depths[name] = 1 + max((depths[other] for other in used), default=0)
                totals[name] = self.sizes.get(name, 0) + sum(totals[other] for other in used)
                continue
            opened.add(name)
            missing = [other for other in dict.fromkeys(used) if other not in totals]
            cyclic = next((other for other in missing if other in opened), None)
            if cyclic is not None:
                raise SourceError(self._where, f"{cyclic[-40:]!r} within itself", "a tree of objects")
            pending += missing
        limit = max(self._max_size, file_bytes)
        if totals[ROOT] > limit or depths[ROOT] > _MAX_DEPTH:
            size = f"{float(totals[ROOT]):.3g} {self._unit}, {depths[ROOT]} deep"
            found = f"instances of {size}" + (f", in {file_bytes} bytes" if file_bytes else "")
            expected = f"at most {limit} {self._unit}, {_MAX_DEPTH} deep"
            raise SourceError(self._where, found, expected, "Export fewer instances.")
