"""Commands for the sequences on a server: recordings in, runs, labels and exports out."""
