"""What steps worlds: C MuJoCo on CPU threads, and MJX on JAX. One protocol: petmjx.engines.base.Engine."""
