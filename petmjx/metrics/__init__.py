"""Metrics: the table of all of them (``spec``), and their arithmetic, written twice.

``motion_np`` and ``force_np`` belong to the C engine, ``motion_jax`` and ``force_jax`` to the MJX engines. Functions
with the same name do the same, but share no arithmetic, so that tests can find an error in one of them. Axes of the
JAX twins are named as in ``petmjx.engines.mjx``.
"""
