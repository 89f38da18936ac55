"""The commands of `stone` that need the platform itself: recordings, labels and models here, and `serve`."""
