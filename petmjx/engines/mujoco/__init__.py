"""Engine mujoco: C MuJoCo on CPU threads, one world per thread. Tests compare the other engines with this engine."""
