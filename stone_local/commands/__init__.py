"""One module per command of the platform: its words and options, one call of a pipeline, and its table."""
