"""Commands that sign in to a server and out of it."""
