"""Every option of a world, of its simulation and of a run, with its default, unit and meaning."""
