"""Worlds as rows of arrays: the engine mjx-jax, and the tables that mjx-warp shares with it.

Array shapes are annotations, which tests check at every call. The axes:

* ``world``: worlds that are simulated together, padded to a power of two.
* ``box``: boxes of a world, padded to the same number in all worlds of a table.
* ``body``: the carrier, then the boxes (MuJoCo's list of bodies begins with the world's body instead); ``body_end``:
  the axis ``body`` with one more entry.
* ``shape``: shapes of the bodies, in the order of bodies; MuJoCo's geoms are the floor and then these shapes.
* ``surface``: surfaces of shapes; friction is given for pairs of surfaces.
* ``coordinate`` and ``velocity``: MuJoCo's coordinates (qpos) and velocities (qvel) of one world.
* ``constraint``: rows of MuJoCo's constraints; ``contact`` and ``geom``: MuJoCo's contacts and shapes; ``pair``: pairs
  of geoms that may touch, with four contacts each.
* ``profile`` and ``step``: rows of the table of profiles, and steps of a profile or of the clock.
* ``n_boxes``: one entry for each number of boxes, from 0 on.
* ``row`` and ``word``: rows that the host reads from a table on the device, and the 32-bit words of each row.
* ``queue``: queues of worlds that wait for a thread block; all worlds in a queue have the same size.
* ``batch`` and ``k``: an axis whose meaning the caller chooses, since the function treats all entries alike.
"""
