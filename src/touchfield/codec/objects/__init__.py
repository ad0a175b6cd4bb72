"""Coder `objects`: stores each body of a scene once, as a field in the body's own frame, and then only the
body's pose in each frame (the "object" source model of the paper's figure 4)."""
