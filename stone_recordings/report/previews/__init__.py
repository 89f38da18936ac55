"""Three pictures of a recording: its cameras' images, one sweep from above, and the robot's track.

**Conventions.** `pictures.previews_of` yields them. Each is a function of the recording alone: equal recordings give
equal bytes. Unreadable parts are left out; the quality report gives the reason.
"""
