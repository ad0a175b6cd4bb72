"""The coder `touch`: errors of at most max(F_0, k |F|); see docs/format/touch.md."""
