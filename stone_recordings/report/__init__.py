"""Reports: what a recording holds, how good it is, and what is wrong with it."""
