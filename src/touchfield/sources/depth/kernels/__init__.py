"""Compiled inner loops of depth scenes: tangent planes of a depth image, forces near them, and fusion."""
