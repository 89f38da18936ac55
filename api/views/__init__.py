"""Views: rows of the platform as bodies of the API."""
