"""Runs the jobs of an engine in worker processes with Ray, on one machine or many. No other package of petmjx imports
Ray."""
