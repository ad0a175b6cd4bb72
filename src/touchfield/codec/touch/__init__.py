"""Coder `touch`, the default: the error of every decoded force is at most max(F_0, k |F|). See
docs/format/touch.md.

The coder itself is in C: ``c/touch_encode.h`` and ``c/touch.h``, compiled into `touchfield._native`.

spec              options
encoder           frames to the body of a segment
  base_layer_fit  fit of a spline, which needs SciPy
  error_bound     spatial masking
decoder           the body of a segment to frames
body              records of a body
"""
