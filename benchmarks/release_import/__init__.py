"""A dataset of the release's size through the whole platform: imported under kills, scored against."""
