"""C MuJoCo on CPU threads: exact models, one world a thread. The oracle."""
