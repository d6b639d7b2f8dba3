"""A leaderboard of packers, as a folder of static HTML pages."""
