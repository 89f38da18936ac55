"""One module per command of `stone`: its words, its options, one call into a pipeline, its table."""
