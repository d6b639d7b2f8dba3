"""The story of one world: told frame by frame, and in words."""
