"""The map's features and its picture in perspective, made tile by tile."""

from functools import partial

import numpy as np
import pytest
from PIL import Image

from services.labeler.previews import feature_maps
from services.labeler.previews.feature_maps import feature_figure, limits_of, rasters_of, write_feature_maps
from services.labeler.previews.map_pieces import MapPiece, extent_of
from services.labeler.previews.map_view import map_oblique
from services.labeler.previews.preview_files import write_map_previews
from stone.geometry.lattice import keys_from_indices
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_RGB, PAPER
from stone.surface.terrain import ROUGHNESS, SLOPE

TRACK = SE3(np.array([[1.0, 0, 0, 0, x, 4.0, 0.4] for x in np.linspace(1, 7, 8)]))
NOTHING = MapPiece(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.uint8))


def piece_of(indices, seed=0):
    keys = np.unique(keys_from_indices(np.asarray(indices, np.int64)))
    rng = np.random.default_rng(seed)
    features = np.stack([rng.normal(3, 1, len(keys)), rng.uniform(0, 1.5, len(keys)), rng.normal(-8, 1, len(keys))])
    return MapPiece(keys, features.T, rng.integers(1, 4, len(keys)).astype(np.uint8))


def random_tiles():
    rng = np.random.default_rng(7)
    low = (np.array([0, 0, -2]), np.array([20, 0, 0]), np.array([0, 25, 3]))
    return [piece_of(rng.integers(0, (20, 25, 6), (400, 3)) + corner, n) for n, corner in enumerate(low)]


def given(pieces):
    return [partial(lambda piece: piece, piece) for piece in pieces]


def slow_rasters(pieces, extent, columns_per_px):
    """Pixel → the mean over its columns of the feature of the highest voxel, by loops."""
    highest = {}
    for piece in pieces:
        for (i, j, k), features in zip(indices_list(piece), piece.features, strict=True):
            if (i, j) not in highest or highest[i, j][0] < k:
                highest[i, j] = (k, features)
    pixels = {}
    for (i, j), (_, features) in highest.items():
        place = ((i - extent.low[0]) // columns_per_px, (j - extent.low[1]) // columns_per_px)
        pixels.setdefault(place, []).append(features)
    return {place: np.mean(features, axis=0) for place, features in pixels.items()}


def indices_list(piece):
    mask = (1 << 21) - 1
    return [((k >> 42) - 2**20, ((k >> 21) & mask) - 2**20, (k & mask) - 2**20) for k in piece.keys.tolist()]


@pytest.mark.parametrize("most_px", [640, 16])
def test_a_pixel_is_the_mean_of_its_columns_highest_voxels(monkeypatch, most_px):
    monkeypatch.setattr(feature_maps, "MOST_SIDE_PX", most_px)
    pieces = random_tiles()
    rasters, extent = rasters_of(given([*pieces, NOTHING])), extent_of(given(pieces))
    columns_per_px = -(-int((extent.high - extent.low)[:2].max()) // most_px)
    wanted = slow_rasters(pieces, extent, columns_per_px)
    assert max(rasters.values.shape[1:]) <= most_px
    assert np.isfinite(rasters.values[0]).sum() == len(wanted)
    for (x, y), features in wanted.items():
        np.testing.assert_allclose(rasters.values[:, rasters.values.shape[1] - 1 - y, x], features)
    west, east, south, north = rasters.bounds_m
    assert (west, south) == pytest.approx(extent.low[:2] * 0.2)
    assert (east - west, north - south) == pytest.approx(np.array(rasters.values.shape[:0:-1]) * columns_per_px * 0.2)


def test_slope_is_shown_in_degrees_and_bars_leave_out_few_values():
    figure = feature_figure(rasters_of(given(random_tiles())), TRACK.translation_m, "local")
    shown = [axes.get_images()[0].get_array() for axes in figure.axes if axes.get_images()]
    assert len(shown) == 3
    assert np.nanmax(shown[SLOPE].filled(np.nan)) == pytest.approx(np.degrees(1.5), abs=1)
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]
    assert titles == ["height above local ground, m", "slope θ, °", "roughness r, ln m²"]
    values = np.random.default_rng(0).normal(-8, 2, 5000)
    least, most = limits_of(values, ROUGHNESS)
    assert np.mean((values < least) | (values > most)) == pytest.approx(0.04, abs=0.002)
    assert limits_of(np.full(4, np.nan), ROUGHNESS) == (0.0, 1.0)
    assert limits_of(np.full(4, 2.0), ROUGHNESS) == (1.5, 2.5)


def test_the_map_in_perspective_shows_all_tiles_whole_and_does_not_depend_on_how_they_are_cut():
    ground = [(i, j, (i + j) // 40) for i in range(200) for j in range(120)]
    whole = MapPiece(piece_of(ground).keys, piece_of(ground).features, np.full(len(ground), 2, np.uint8))
    half = len(whole.keys) // 2
    cut = [MapPiece(whole.keys[s], whole.features[s], whole.classes[s]) for s in (slice(half), slice(half, None))]
    picture = np.asarray(map_oblique(given([whole]), TRACK))[:720]
    rim = np.concatenate([picture[:4].reshape(-1, 3), picture[:, :4].reshape(-1, 3), picture[:, -4:].reshape(-1, 3)])
    assert (rim == PAPER).all()
    covered = (picture != PAPER).any(axis=2)
    assert covered.any(axis=0).mean() > 0.6
    assert (np.asarray(map_oblique(given(cut), TRACK)) != np.asarray(map_oblique(given([whole]), TRACK))).mean() < 0.01
    colours = {tuple(colour) for colour in picture.reshape(-1, 3)[::7].tolist()}
    assert CLASS_RGB[2] in colours


@pytest.mark.whole
def test_map_previews_are_the_same_twice_and_an_empty_map_is_drawn_too(tmp_path):
    for folder, pieces in (("a", random_tiles()), ("b", random_tiles()), ("empty", [NOTHING])):
        (tmp_path / folder).mkdir()
        write_map_previews(given(pieces), TRACK, tmp_path / folder)
    for name in ("map.png", "features.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
        with Image.open(tmp_path / "empty" / name) as picture:
            assert picture.format == "PNG"
            assert picture.width <= 1280


def test_features_are_not_half_written(tmp_path):
    def breaks():
        raise RuntimeError("the tile is gone")

    with pytest.raises(RuntimeError, match="the tile is gone"):
        write_feature_maps([breaks], TRACK, tmp_path / "features.png")
    assert list(tmp_path.iterdir()) == []
