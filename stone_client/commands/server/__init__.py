"""Commands for sequences on a server, and the one that starts a server."""
