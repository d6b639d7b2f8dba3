"""Pages: one HTML file each, which opens offline in any browser and asks nothing of any server."""
