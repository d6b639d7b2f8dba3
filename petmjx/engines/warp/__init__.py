"""Engine mjx-warp: batches of worlds on CUDA devices, with a step and a contact solver of petmjx's own."""
