"""Commands for the dataset on a server: statistics, splits, versions."""
