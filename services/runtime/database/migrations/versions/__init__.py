"""The revisions, from the baseline on."""
