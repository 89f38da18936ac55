"""The API on a socket, and those who call it."""
