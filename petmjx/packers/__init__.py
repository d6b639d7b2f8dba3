"""Packers compared by the runs of their plans for the same orders."""
