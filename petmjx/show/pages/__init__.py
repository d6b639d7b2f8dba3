"""Pages. Each is one HTML file that can be opened offline in any browser and requests nothing from a server."""
