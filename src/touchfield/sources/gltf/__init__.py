"""glTF 2.0: the document and its model, with skins, morph targets and animations."""
