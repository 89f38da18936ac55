"""Real servers, worlds and users for tests, chaos and benchmarks."""
