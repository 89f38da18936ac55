"""One module per command of `stone`: its words and options, one call of a pipeline, and its table."""
