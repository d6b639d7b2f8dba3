"""The base of petmjx: errors, texts, units, files, checks, processes. This package imports no other package of
petmjx."""
