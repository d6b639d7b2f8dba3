"""What all of petmjx stands on, and what knows nothing of it: errors, texts, units, files, checks."""
