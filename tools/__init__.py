"""Programs that make files of this repository, or pages of its site, from other files. Not a part of the package."""
