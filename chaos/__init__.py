"""The kill suite: real processes killed at work, repeatedly, and the invariants checked each time.

**Conventions.** A round is one kill and its run. A new owner uploads the same recording, so no earlier result is
reused, and all results must equal those of an undisturbed run byte for byte. A kind is one way to kill; its rounds
share a platform that stays up. A violation is a job or file *lost*, work *doubled*, or bytes *differing*. Read `rounds`
first, then `verdict`; `kinds` and `process_kills` choose victims and moments. Random choices come from the printed
seed; the machine's timing does not.
"""
