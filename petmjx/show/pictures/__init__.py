"""Pictures, films and recordings of the story of one plan, drawn without a display (docs/seeing.md)."""
