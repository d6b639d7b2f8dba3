"""Other simulators, which judge plans that petmjx judges: one module each, all with the protocol in ``referee``.

Referees are no part of petmjx: ``pip install '.[referees]'``. A module imports its simulator on its own import.
"""
