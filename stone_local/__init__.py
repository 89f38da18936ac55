"""The commands of `stone` that require the platform itself: local recordings, labels and models, and `serve`."""
