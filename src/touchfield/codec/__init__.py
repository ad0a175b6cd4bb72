"""Coders: `registry` names them; `touch` is ours, `paper` the paper's, `objects` that of bodies with poses."""

from touchfield.rooms import modules_of

__getattr__ = modules_of(__name__)
