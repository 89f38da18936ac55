"""Shared runtime of the platform's processes: database, store, jobs, uploads, telemetry."""
