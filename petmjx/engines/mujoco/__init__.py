"""Engine mujoco: C MuJoCo on CPU threads, with exact models and one world per thread. It is the oracle."""
