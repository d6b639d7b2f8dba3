"""Metrics: the table of what they are (``spec``), and their arithmetic twice over.

``motion_np`` and ``force_np`` are the C engine's, ``motion_jax`` and ``force_jax`` the MJX engines'. Functions of one
name do the same, but share no arithmetic, so that one can show the other wrong. Axis names of the JAX twins: ``lane``
a slot of the batch, ``box`` a padded box, ``contact`` a contact of one lane's or of the shared pool.
"""
