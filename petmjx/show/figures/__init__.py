"""Charts of results as figures for papers."""
