"""Plans rated as BED-BPP rates them: KPIs, the leaderboard's score, and the file that is submitted to it."""
