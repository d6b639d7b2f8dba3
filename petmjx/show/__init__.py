"""Output for people: tables and progress in the terminal, figures, pictures, pages, reports and leaderboards."""
