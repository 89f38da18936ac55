"""The sweeper's chores by loop, in their order."""

CHORES = {
    "jobs": ["jobs"],
    "submissions": ["submissions"],
    "recordings": ["recordings"],
    "cleaning": [
        "submitted files",
        "uploads",
        "label sets",
        "blobs",
        "credentials",
        "audit log",
        "workers",
        "ballast",
    ],
    "scrub": ["scrub"],
    "notifications": ["phases", "events", "deliveries", "lost deliveries", "old events"],
    "senderone": ["senderone"],
    "sendertwo": ["sendertwo"],
}
