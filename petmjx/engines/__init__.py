"""The engines, which simulate worlds: C MuJoCo on CPU threads, MJX on JAX, and Warp kernels on GPU or CPU.

The interface of all engines is ``petmjx.engines.protocol.Engine``.
"""
