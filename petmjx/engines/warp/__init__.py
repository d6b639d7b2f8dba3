"""Engine mjx-warp: batches of worlds on CUDA devices. petmjx has its own step and contact solver for it."""
