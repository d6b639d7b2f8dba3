"""Pages: each is one HTML file that opens offline in any browser and requests nothing from a server."""
