"""The coder `touch`: errors of at most max(F_0, k |F|); docs/format/touch.md defines its bytes."""
