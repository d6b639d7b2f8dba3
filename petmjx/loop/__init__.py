"""Physics for programs that place box after box: simulated pallets that stay in memory between placements, and labels
of placements for training models."""
