"""Closed-form criteria of static stability: what packers use inside, and whether physics agrees with it.

Nothing here simulates. SciPy and shapely (``pip install 'petmjx[packers]'``) are imported by the modules that use them.
"""
