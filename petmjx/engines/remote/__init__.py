"""Runs the jobs of an engine in worker processes with Ray, on one machine or many. Only this package imports Ray."""
