"""Processes beside a run: further attempts at single worlds on CPU threads while a GPU goes on, and checks of
outcomes."""
