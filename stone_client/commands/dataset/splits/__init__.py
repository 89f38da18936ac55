"""Commands for the draft splits of the dataset on a server."""
