"""The paper's tables and figures, each a small script over the library: `touchfield reproduce`."""

from touchfield.rooms import modules_of

__getattr__ = modules_of(__name__)
