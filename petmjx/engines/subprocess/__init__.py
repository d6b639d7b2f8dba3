"""Processes beside a run. They simulate single worlds again on CPU threads while a GPU continues, and check
outcomes."""
