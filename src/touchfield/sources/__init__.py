"""Sources: scenes of all kinds as generators of force fields; `registry` opens them, `laws` make the forces."""

from touchfield.rooms import modules_of

__getattr__ = modules_of(__name__)
