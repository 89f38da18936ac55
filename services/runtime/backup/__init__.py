"""Online backup of the platform, and its restore into an empty platform.

**Conventions.** First a snapshot of the database (every table in one transaction), then every object that the snapshot
refers to. Referenced objects exist and never change, and garbage collection is paused, so rows and objects are
consistent. Contents are stored by sha256, once for all snapshots of a folder, so the next backup copies only new
contents. A snapshot appears atomically by a rename when it is complete, and never changes afterwards.

    <folder>/objects/<2 hex>/<sha256>            contents
    <folder>/snapshots/<UTC time>/snapshot.json  its source, its tables with their hashes, and its flaws
    <folder>/snapshots/<UTC time>/tables/*.zst   rows in PostgreSQL's COPY text format, for both databases
    <folder>/snapshots/<UTC time>/files.json     files that are not blobs: work of unfinished runs, unfinished uploads

Start with `taking`, then `restoring`. A backup contains password hashes, hidden ground truth and all recordings.
"""
