"""Engine mujoco: C MuJoCo on CPU threads, exact models, one world per thread. The oracle."""
