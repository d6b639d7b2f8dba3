"""Every option, with its default, unit and meaning: of the world, of its simulation, of a run."""
