"""Engine mjx-warp: batches of worlds on CUDA devices, with petmjx's own step and contact solver."""
