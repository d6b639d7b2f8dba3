"""Metrics: the table of all of them (``spec``), and their arithmetic, written twice.

``motion_np`` and ``force_np`` belong to the C engine, ``motion_jax`` and ``force_jax`` to the MJX engines. Functions
with the same name do the same, but share no arithmetic, so that tests can find an error in one of them. Axis names in
the JAX twins: ``lane``: a slot of the batch; ``box``: a padded box; ``contact``: a contact of one lane, or of the pool
that all lanes share.
"""
