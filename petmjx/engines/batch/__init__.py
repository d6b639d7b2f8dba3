"""The base of both MJX engines, which simulate padded batches of worlds in stages; and the engine mjx-jax.

Shapes are annotations that tests check at every call. Their axes, here and in ``petmjx.metrics``:

* ``world``: worlds of a table, padded to a power of two. In the records of a stage there is one world a lane;
* ``lane``: places of a stage, each of which steps one world at a time;
* ``box``: boxes of a world, padded to the capacity of the stage or the width of the table;
* ``body``: the carrier, then the boxes, and with ``body_end`` one more; MuJoCo's have the world's body before them;
* ``shape``: shapes of the bodies, in their order; with the floor before them they are MuJoCo's geoms;
* ``coordinate``: generalized positions or velocities of one lane;
* ``profile`` and ``step``: rows of the table of profiles, and steps of a profile or of the clock;
* ``n_boxes``: one entry for each number of boxes, from 0 on;
* ``row``: rows of a table that are picked;
* ``queue``: of worlds that wait for lanes of one size;
* ``batch`` and ``k``: whatever the caller has; the function treats all of it alike.
"""
