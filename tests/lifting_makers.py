"""The lifting of both chains by their dimensions, for the tests."""

from __future__ import annotations

from touchfield.filters.lifting import (
    fcc_coarse,
    fcc_forward,
    fcc_inverse,
    quincunx_coarse,
    quincunx_forward,
    quincunx_inverse,
)

FORWARD = {2: quincunx_forward, 3: fcc_forward}
INVERSE = {2: quincunx_inverse, 3: fcc_inverse}
COARSE = {2: quincunx_coarse, 3: fcc_coarse}
