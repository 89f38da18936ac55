"""The revisions, in folders of twenty; a new one goes into the last."""
