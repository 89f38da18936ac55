"""From credentials on."""
