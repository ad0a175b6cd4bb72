"""The coder `touch`: no error beyond max(F_0, k |F|) (docs/format/touch.md tells its bytes)."""
