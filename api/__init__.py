"""The REST API (FastAPI) of the platform."""
