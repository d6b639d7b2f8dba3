"""Programs that make files of this repository, or pages of its site, from other files. No part of the package."""
