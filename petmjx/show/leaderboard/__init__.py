"""A leaderboard of packers: a folder of static pages."""
