"""glTF 2.0 in motion: documents, accessors, node trees, skins, morph targets and animations (Khronos, 2021)."""
