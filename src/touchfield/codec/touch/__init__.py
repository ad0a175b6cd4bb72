"""The coder `touch`: errors of at most max(F_0, k |F|); see docs/format/touch.md.

spec              options
encoder           frames to the body of a segment, checked against the error bound; exact mode
  frame_encoder   the mode of each frame, and its code
  base_layer_fit  fit of the base layers
decoder           the body of a segment to frames
  frame           one decoded frame, and what the next frame is predicted from
  base_layer      evaluation of the base layers
body              records of a body
lattice           step sizes of the quantised forces
error_bound       comparison of a decoded frame with its original
warm              compilation of the kernels in advance

kernels/          the voxel pass, compiled
  decode_pass     order of bricks and voxels, shared by both directions
  encode_pass     the encoder's choices: follow or copy a brick, skip a residual, its value
  voxel           prediction, contexts and code of one voxel
  workspace       scan, step table, and the 12^3 window around a brick
  guess, columns_fit   base layers
  exact           the exact mode
  (codec/kernels.py has the range coder and the mixing of probabilities)
"""
