"""Three pictures of a recording: what its cameras saw, one sweep from above, and where the robot went.

**Conventions.** `pictures.previews_of` gives them. Each is a function of the recording alone: equal recordings, equal
bytes. What cannot be read is left out; why, the quality report says.
"""
