"""The API on a socket, and its callers."""
