"""Pictures, films and recordings of one plan's story, drawn without a display (docs/seeing.md)."""
