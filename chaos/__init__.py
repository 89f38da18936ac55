"""The kill suite: real processes killed while they work, again and again, and what must be true after each time.

**Conventions.** A round is one kill and the run it hits: a new owner brings the same recording, so nothing is answered
from an earlier round and everything made must equal what an undisturbed run made, byte for byte. A kind is one way to
kill; its rounds share a platform that stays up. A violation is a job or file *lost*, work *doubled*, or bytes
*differing*. Read `rounds` first, then `verdict`; `kinds` and `aims` say who is killed when. Everything random is drawn
from the seed that is printed, the machine's timing is not.
"""
