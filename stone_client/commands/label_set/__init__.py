"""Commands for the label sets of a sequence on a server, or in local folders."""
