"""Boxes placed as they come: packers that see the next box, or the next few, of an order in its given sequence."""
