"""What both MJX engines share: padded batches of worlds in stages; and the engine mjx-jax."""
