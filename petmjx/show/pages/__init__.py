"""Pages in HTML. Each page is a single file that can be opened offline in any browser, and requests nothing from a
server."""
