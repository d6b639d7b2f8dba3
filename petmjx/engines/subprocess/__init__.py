"""Further attempts at single worlds, in a process of their own beside the run: on CPU threads, while a GPU goes on."""
