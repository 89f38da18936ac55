"""The pages of administrators: jobs, queues, benchmarks and phases."""
