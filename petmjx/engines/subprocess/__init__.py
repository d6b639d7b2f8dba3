"""Processes beside a run. These processes simulate single worlds again on CPU threads while a GPU continues (the
attempt process), check outcomes, and compile kernels."""
