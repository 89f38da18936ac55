"""Middleware of every request: ids, limits, idempotency, security headers."""
