"""Runs the jobs of an engine in worker processes on one machine or many, with Ray. No other package of petmjx imports
Ray."""
