"""Profiles: what shakes a pallet after it has been packed; ``registry`` has them by name."""
