"""Statics: closed-form criteria of stability, which packers use inside, and whether physics agrees with them; the least
and the most force on boxes at rest.

Nothing here simulates. SciPy and shapely (``pip install 'petmjx[packers]'``) are imported by the modules that use them.
"""
