"""What people are shown in a terminal: progress and tables."""
