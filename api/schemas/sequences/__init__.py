"""Bodies of sequences and of all that belongs to one: recordings, calibrations, runs, labels, frames, exports."""
