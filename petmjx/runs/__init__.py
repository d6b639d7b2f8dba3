"""Runs: which worlds are made of plans, scores, sweeps and searches, and their summaries."""
