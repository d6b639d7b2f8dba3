"""Runs: scores, sweeps and searches. Makes worlds of plans, simulates them, and summarises the results."""
