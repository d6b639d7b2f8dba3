"""The kernel of mjx-warp: Warp functions for a step of a block's world, and the loop over steps and worlds.

Warp compiles these modules for the device, together with the C++ of petmjx/engines/warp/solver/newton.cu. Type checkers
understand these modules only in part. ``float(…)``, ``int(…)`` and ``bool(…)`` declare variables that loops change. The
only operation on arrays is indexing. All threads of a block must reach each barrier.

Arguments come in the order of mujoco_warp's kernels. Constants come first (``# Model:``), then records that are only
read (``# Data in:``), then other values (``# In:``), then records that change (``# Data out:``) and may also be read. A
function without these comments changes only its own variables.
"""
