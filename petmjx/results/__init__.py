"""Reads and writes the folder of a run. Tables are written as several files, called *parts*."""
