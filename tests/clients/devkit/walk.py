"""Opens an export with nuscenes-devkit, walks all of it, and says what it found as JSON: walk.py DATAROOT [PLACES].

PLACES is a JSON file of lists [x, y] in the global frame; for each list it says which of them are on the map mask.

Run with warnings as errors in the environment of deploy/install-devkit.sh; not a test by itself.
"""

import contextlib
import io
import json
import sys
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud, RadarPointCloud
from nuscenes.utils.splits import get_scenes_of_split
from PIL import Image


def keys_resolve(nusc):
    """Every token of every row names a row; how many did."""
    followed = 0
    tables = {f"{table}_token": table for table in nusc.table_names}
    tables |= {"first_sample_token": "sample", "last_sample_token": "sample"}
    for table in nusc.table_names:
        for row in getattr(nusc, table):
            assert nusc.get(table, row["token"]) is row
            for key, value in row.items():
                if key in tables:
                    assert nusc.get(tables[key], value)["token"] == value
                    followed += 1
    return followed


def chain(nusc, table, first, way):
    """Tokens from `first` on, `way` being prev or next."""
    tokens, at = [], first
    while at:
        tokens.append(at)
        at = nusc.get(table, at)[way]
    return tokens


def chains_hold(nusc):
    """Every chain, walked both ways, is the same; gives the length of each sensor's."""
    for scene in nusc.scene:
        there = chain(nusc, "sample", scene["first_sample_token"], "next")
        assert there == chain(nusc, "sample", scene["last_sample_token"], "prev")[::-1]
        assert len(there) == scene["nbr_samples"]
        stamps = [nusc.get("sample", token)["timestamp"] for token in there]
        assert stamps == sorted(stamps)
    lengths = {}
    for row in nusc.sample_data:
        if row["prev"] == "":
            there = chain(nusc, "sample_data", row["token"], "next")
            assert there == chain(nusc, "sample_data", there[-1], "prev")[::-1]
            assert {nusc.get("sample_data", token)["channel"] for token in there} == {row["channel"]}
            lengths[row["channel"]] = lengths.get(row["channel"], 0) + len(there)
    assert sum(lengths.values()) == len(nusc.sample_data)
    return lengths


def opened(nusc):
    """Open every file with the devkit's own loaders; how many points or pixels each channel has."""
    held = {}
    for row in nusc.sample_data:
        path, boxes, intrinsic = nusc.get_sample_data(row["token"])
        assert boxes == []
        if row["sensor_modality"] == "lidar":
            points = LidarPointCloud.from_file(path).points
        elif row["sensor_modality"] == "radar":
            points = RadarPointCloud.from_file(path).points
        else:
            assert intrinsic.shape == (3, 3)
            with Image.open(path) as image:
                image.load()
                assert image.size == (row["width"], row["height"])
                points = np.asarray(image).reshape(-1, 3).T
        assert np.isfinite(points).all()
        held[row["channel"]] = held.get(row["channel"], 0) + points.shape[1]
    return held


def projected(nusc):
    """Pixels of the middle sample's LiDAR in each of its cameras."""
    data = nusc.sample[len(nusc.sample) // 2]["data"]
    pixels = {}
    for channel in sorted(name for name in data if name.startswith("CAM")):
        points, depths, image = nusc.explorer.map_pointcloud_to_image(data["LIDAR_TOP"], data[channel])
        image.close()
        pixels[channel] = np.column_stack([points[:2].T, depths]).tolist()
    return pixels


def said(nusc):
    """What the lists print."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        nusc.list_scenes()
        nusc.list_categories()
        nusc.list_attributes()
        nusc.list_sample(nusc.sample[0]["token"])
    return text.getvalue()


def on_mask(nusc, lists):
    mask = nusc.map[0]["mask"]
    return [mask.is_on_mask(*np.array(places).T).tolist() for places in lists]


def drawn_map(nusc):
    """Shares of the picture around the robot, in the first and last sample, that are map and not background."""
    shares = []
    for sample in (nusc.sample[0], nusc.sample[-1]):
        figure, axes = plt.subplots()
        with warnings.catch_warnings():  # the devkit makes an int of an array of one, whatever the data
            warnings.simplefilter("ignore", DeprecationWarning)
            nusc.explorer.render_ego_centric_map(sample["data"]["LIDAR_TOP"], axes_limit=40, ax=axes)
        picture = np.asarray(axes.images[0].get_array())
        assert picture.shape == (800, 800)
        shares.append(float((picture == 125).mean()))
        plt.close(figure)
    return shares


def main(dataroot, places=None):
    nusc = NuScenes(version="v1.0-trainval", dataroot=dataroot, verbose=False)
    lidar = nusc.sample[-1]["data"]["LIDAR_TOP"]
    swept, _ = LidarPointCloud.from_file_multisweep(nusc, nusc.sample[-1], "LIDAR_TOP", "LIDAR_TOP", nsweeps=3)
    found = {
        "rows": {table: len(getattr(nusc, table)) for table in nusc.table_names},
        "files": sorted(path.name for path in (Path(dataroot) / "v1.0-trainval").iterdir()),
        "followed": keys_resolve(nusc),
        "chains": chains_hold(nusc),
        "held": opened(nusc),
        "projected": projected(nusc),
        "swept": swept.nbr_points(),
        "boxes": len(nusc.get_boxes(lidar)),
        "on_mask": on_mask(nusc, json.loads(Path(places).read_text()) if places else []),
        "drawn_map": drawn_map(nusc),
        "scenes": get_scenes_of_split("all", nusc),
        "said": said(nusc),
    }
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
