"""The base of both MJX engines, which simulate padded batches of worlds in stages; and the engine mjx-jax."""
