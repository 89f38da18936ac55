"""Real servers for tests: PostgreSQL, Redis and S3, each a child process that cannot outlive the test run."""
