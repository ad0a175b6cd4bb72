"""The coder `touch`: no decoded force beyond what a hand can feel (docs/format.md tells its bytes)."""
