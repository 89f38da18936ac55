"""Online backup of the platform, and its restore into an empty one.

**Conventions.** First a snapshot of the database (every table in one transaction), then every object that the snapshot
names: what a row names exists and never changes, and garbage collection is held off, so both belong together although
they were not read at once. Contents are kept by sha256, once for all snapshots of a folder, so the next backup only
brings what is new. A snapshot appears when all of it is there (an atomic rename), and nothing of it is changed
afterwards.

    <folder>/objects/<2 hex>/<sha256>            contents
    <folder>/snapshots/<UTC time>/snapshot.json  what it is of, its tables with their hashes, what was amiss
    <folder>/snapshots/<UTC time>/tables/*.zst   rows in PostgreSQL's COPY text format, whichever database they are of
    <folder>/snapshots/<UTC time>/files.json     files that are no blobs: work of runs not over, uploads under way

Read `taking` first, then `restoring`. A backup holds password hashes, hidden ground truth and all recordings.
"""
