"""The base of petmjx: errors, texts, units, files, checks, processes. It imports no other package of petmjx."""
