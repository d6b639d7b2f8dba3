"""The page about runs: what came out, charts, a table of all plans, and each of them in 3D."""
