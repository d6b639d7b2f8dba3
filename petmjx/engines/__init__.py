"""Engines simulate worlds: C MuJoCo on CPU threads, and MJX on JAX. Their protocol: petmjx.engines.protocol.Engine."""
