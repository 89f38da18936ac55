"""A dataset of the release's size through the whole platform: imported under kills, and scored."""
