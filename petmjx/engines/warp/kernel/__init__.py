"""The kernel of mjx-warp: Warp functions for one step of a block's world, and the loop over steps and worlds.

Warp compiles these modules for the device, and the C++ of petmjx/engines/warp/newton.cu with them. Type checkers
understand them only in part: ``float(…)``, ``int(…)`` and ``bool(…)`` declare variables that loops change, arrays are
indexed, and barriers must be reached by all threads of a block.
"""
