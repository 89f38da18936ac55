"""The chart for a cluster: rendered by Helm itself, held against schemas and against what those cannot say."""
