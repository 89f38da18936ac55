"""Domain logic: the rows and rules of sequences, datasets, benchmarks and exports, one folder per noun."""
