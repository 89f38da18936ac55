"""A twin of the release, at its full size and at its grid, through the whole platform."""
