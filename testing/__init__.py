"""Real servers, worlds and people for whoever tries the platform: tests, chaos and benchmarks."""
