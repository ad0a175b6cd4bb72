"""Compiled loops over depth images: tangent planes, forces, and fusion."""
