"""Physics in the loop: pallets that stay settled, for packers that try one placement after another."""
