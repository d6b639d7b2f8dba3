"""All options of simulations and of runs, with their defaults, units and meanings."""
