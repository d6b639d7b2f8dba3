"""Worlds as rows of arrays: the engine mjx-jax, and what mjx-warp shares with it.

Shapes are annotations that tests check at every call. Their axes:

* ``world``: worlds that are simulated together, padded to a power of two;
* ``box``: boxes of a world, padded to the same number in all worlds of a table;
* ``body``: the carrier, then the boxes, and with ``body_end`` one more; MuJoCo's have the world's body before them;
* ``shape``: shapes of the bodies, in their order; with the floor before them they are MuJoCo's geoms;
* ``surface``: surfaces of shapes, between which friction is said;
* ``coordinate`` and ``velocity``: generalized positions and velocities of one world;
* ``constraint``: rows of MuJoCo's constraints; ``contact`` and ``geom``: its contacts and its shapes;
* ``profile`` and ``step``: rows of the table of profiles, and steps of a profile or of the clock;
* ``n_boxes``: one entry for each number of boxes, from 0 on;
* ``row`` and ``word``: rows of a table that are picked, and the numbers in each;
* ``queue``: of worlds of one size that wait for a thread block;
* ``batch`` and ``k``: whatever the caller has; the function treats all of it alike.
"""
