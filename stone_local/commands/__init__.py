"""One module per command of the platform: its words, its options, one call into a pipeline, its table."""
