"""The error bound of a segment, computed here in float64 from its definition (docs/format/touch.md)."""

from __future__ import annotations

import numpy as np

from touchfield.codec.touch.error_bound import allowed_error_n
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField

__all__ = ["error_ratios"]


def _dense_masking_n(original: ForceField, spec: TouchSpec) -> np.ndarray:
    """Error that surrounding forces hide at each sample, newtons [nx, ny, nz]."""
    out = np.zeros([8 * n for n in original.grid.brick_shape])
    for (x, y, z), hidden_n in zip(8 * original.bricks, allowed_error_n(original, spec).reshape(-1, 8, 8, 8)):
        out[x : x + 8, y : y + 8, z : z + 8] = hidden_n
    return out[tuple(slice(n) for n in original.grid.shape)]


def error_ratios(original: ForceField, decoded: ForceField, spec: TouchSpec) -> np.ndarray:
    """Error at each sample over the error that the options allow, [nx, ny, nz]; infinite if none is allowed.

    Mode "lossless" allows no bit to differ, support "exact" no force to vanish or appear; mode "nmse" allows
    any error.
    """
    f, d = (field.to_dense().astype(np.float64) for field in (original, decoded))
    is_supported, is_sent = f.any(axis=-1), d.any(axis=-1)
    error = np.linalg.norm(d - f, axis=-1)
    if spec.mode == "nmse":
        ratios = np.zeros(error.shape)
    elif spec.mode == "lossless":
        bits = (field.to_dense().view(np.uint32) for field in (original, decoded))
        return np.where(np.not_equal(*bits).any(axis=-1), np.inf, 0.0)
    else:
        size = np.linalg.norm(f, axis=-1)
        allowed = np.maximum(spec.f0_n, spec.k * size + _dense_masking_n(original, spec))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.where(error == 0, 0.0, error / allowed)
            if spec.mode == "mask-direction":
                jnd = np.radians(spec.direction_jnd_deg)
                angle = np.arctan2(np.linalg.norm(np.cross(f, d), axis=-1), (f * d).sum(axis=-1))
                length = np.abs(np.linalg.norm(d, axis=-1) - size) / allowed
                weak = np.where(error == 0, 0.0, error / spec.f0_n)
                ratios = np.where(size * np.sin(jnd) > spec.f0_n, np.maximum(length, angle / jnd), weak)
    return np.where(is_supported != is_sent, np.inf, ratios) if spec.support == "exact" else ratios
