"""Batched metrics of the MJX engines: pure functions of arrays with a leading lane axis.

The C engine has its own, in NumPy (``petmjx.metrics.force_np and motion_np``); the two share no arithmetic, so that one
can show the other wrong. Axis names: ``lane`` a slot of the batch, ``box`` a padded box, ``contact`` a
contact of one lane's or of the shared pool.
"""
