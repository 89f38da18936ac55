"""Commands for the sequences on a server: recordings, runs, labels and exports."""
