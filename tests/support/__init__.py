"""Code that several tests use: builders of plans, worlds and outcomes, a fake stepper, runs of the command line."""
