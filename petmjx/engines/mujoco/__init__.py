"""Engine mujoco: C MuJoCo on CPU threads, one world per thread. The other engines are tested against it."""
