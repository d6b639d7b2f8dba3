"""Runs the jobs of an engine in worker processes on one machine or many, by Ray. Nothing else here imports Ray."""
