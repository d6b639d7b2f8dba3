"""Other simulators, which judge plans that petmjx judges: one module each, all with the protocol of ``base``.

Referees are no part of petmjx: ``pip install '.[referees]'``. A module imports its simulator on its own import.
"""
