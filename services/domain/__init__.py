"""The domain: sequences, datasets, benchmarks and exports as rows with their rules, one folder per noun."""
