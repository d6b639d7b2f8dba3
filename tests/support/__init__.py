"""What tests share: builders of plans, worlds and outcomes, a fake stepper, runs of the command line."""
