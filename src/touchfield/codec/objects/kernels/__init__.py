"""The compiled loops of the coder `objects`."""
