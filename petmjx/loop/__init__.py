"""Physics in the loop: pallets that stay settled, for packers that try placement after placement."""
