"""Referees: other simulators, which judge the same plans as petmjx. Each simulator has a module, which implements the
protocol in ``referee``. Their packages are not installed with petmjx: ``pip install '.[referees]'``. A module imports
its simulator when it is imported.
"""
