"""Runs: scores, sweeps and searches. Makes simulated worlds of plans, simulates them, and summarises the results."""
