"""Routes of signing in otherwise than by name and password: with a provider, and of programs by a browser."""
