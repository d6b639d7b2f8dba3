"""Reads and writes the folder of a run, one part at a time."""
