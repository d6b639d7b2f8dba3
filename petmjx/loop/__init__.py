"""Physics in the loop: pallets that stay settled, for those who ask about one placement after the other."""
