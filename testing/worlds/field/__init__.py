"""Short recordings as other drivers and packages write them, for tests with realistic input."""
