"""The kernel of mjx-warp: Warp functions for one step of a block's world, and the loop over steps and worlds.

Warp compiles these modules for the device, and the C++ of petmjx/engines/warp/solver/newton.cu with them. Type checkers
understand them only in part: ``float(…)``, ``int(…)`` and ``bool(…)`` declare variables that loops change, arrays are
indexed, and barriers must be reached by all threads of a block.

Arguments come in the order of mujoco_warp's kernels: constants (``# Model:``), records that are only read (``# Data
in:``), other values (``# In:``), and records that change (``# Data out:``), which may be read, too. A function without
these comments changes nothing but its own variables.
"""
