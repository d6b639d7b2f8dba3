"""The base of petmjx, which imports no other room: errors, texts, units, files, checks, processes."""
