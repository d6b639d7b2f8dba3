"""The report about runs, on one page: outcomes, charts, a table of all plans, and each plan in 3D."""
