"""Engine mjx-warp: many worlds at a time on CUDA devices, with petmjx's own simulation step and contact solver."""
