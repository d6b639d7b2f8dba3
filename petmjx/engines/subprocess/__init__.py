"""Processes beside a run: for further attempts at single worlds on CPU threads while a GPU continues, and for checks of
outcomes."""
