"""The `stone` command: words, options, progress and exit codes around the pipelines."""
