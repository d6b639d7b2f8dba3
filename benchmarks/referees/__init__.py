"""Other simulators, which judge plans that petmjx judges: one module each, all with the protocol of ``base``.

They are no part of petmjx: ``pip install '.[referees]'``. A module imports its simulator when it is imported itself.
"""
