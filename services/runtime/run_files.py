"""The two files with which ingest hands a sequence to the labeler, in the workspace of their run."""

SEQUENCE_FILE = "sequence.npz"
SWEEPS_FILE = "sweeps.npz"
