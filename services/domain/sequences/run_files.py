"""Names of the files that ingest hands to the labeler in a run's workspace.

**Conventions.** Of several recordings the `joined.json` that describes them (`stone_files.joined_file`) lies beside
these and is published with the labels: what is made later opens the recordings with the offsets of those labels.
"""

SEQUENCE_FILE = "sequence.npz"
SWEEPS_FILE = "sweeps.npz"
