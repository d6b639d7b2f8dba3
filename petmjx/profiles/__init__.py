"""Profiles: what shakes a pallet after it has been packed. `petmjx.forces` is the place to look them up."""
