"""Pictures, films and recordings of a story (the simulation of one plan), drawn without a display (docs/seeing.md)."""
