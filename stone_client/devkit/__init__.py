"""Labels and sensor data of a dataset as NumPy arrays, read in place, frame by frame.

from stone_client.devkit import open_dataset

for frame in open_dataset("STONE.zip"):
    print(frame.token, frame.semantics.shape, frame.observed.mean(), len(frame.sweep))
"""

from stone_client.devkit.dataset import Dataset, open_dataset
from stone_client.devkit.frame import Frame

__all__ = ["Dataset", "Frame", "open_dataset"]
