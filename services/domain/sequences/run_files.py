"""Names of the files that ingest hands to the labeler in a run's workspace."""

SEQUENCE_FILE = "sequence.npz"
SWEEPS_FILE = "sweeps.npz"
