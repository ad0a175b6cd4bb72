"""Triangle meshes as scenes: files, surfaces, signed distance."""
