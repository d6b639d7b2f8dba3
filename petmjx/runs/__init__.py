"""Runs: scores, sweeps and searches. Makes worlds (simulations) from plans, simulates the worlds, and summarises the
results."""
