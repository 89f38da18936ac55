"""Faces of voxels against looking at the six neighbours of each."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from services.labeler.imports.voxel_surface import CORNERS, coarser, exposed_faces, few_faces
from stone.geometry.lattice import indices_of, keys_from_indices

SIZE_M = 0.5
Voxels = dict[tuple[int, int, int], int]
places = st.tuples(st.integers(-3, 3), st.integers(-3, 3), st.integers(-3, 3))
worlds = st.dictionaries(places, st.integers(1, 3), max_size=40)
SIDES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1))


def arrays_of(voxels: Voxels) -> tuple[np.ndarray, np.ndarray]:
    ordered = sorted(voxels)
    keys = keys_from_indices(np.array(ordered, np.int64).reshape(-1, 3))
    return keys, np.array([voxels[place] for place in ordered], np.uint8)


def faces_of(voxels: Voxels) -> set[tuple[tuple[float, ...], tuple[float, ...], int]]:
    """(middle, normal, class) of every face without a neighbour."""
    found = set()
    for place, kind in voxels.items():
        for side in SIDES:
            if tuple(np.add(place, side)) not in voxels:
                middle = (np.array(place) + 0.5 + np.array(side) / 2) * SIZE_M
                found.add((tuple(middle.tolist()), tuple(map(float, side)), kind))
    return found


@given(worlds)
@settings(max_examples=80, deadline=None)
def test_a_face_is_there_where_no_voxel_covers_it_and_shows_its_outside(voxels: Voxels) -> None:
    mesh = exposed_faces(*arrays_of(voxels), SIZE_M)
    corners = mesh.vertices_m[mesh.triangles].reshape(-1, 2, 3, 3)
    kinds = mesh.classes[mesh.triangles].reshape(-1, 6)
    assert (kinds == kinds[:, :1]).all()
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]) / SIZE_M**2
    assert np.array_equal(normals[:, 0], normals[:, 1])
    middles = corners.reshape(-1, 6, 3)[:, [0, 1, 2, 5]].mean(axis=1)
    found = [(tuple(m), tuple(n), int(k)) for m, n, k in zip(middles.tolist(), normals[:, 0].tolist(), kinds[:, 0])]  # noqa: B905
    assert len(found) == len(set(found))
    assert set(found) == faces_of(voxels)


@given(worlds)
@settings(max_examples=40, deadline=None)
def test_vertices_of_one_class_are_shared(voxels: Voxels) -> None:
    mesh = exposed_faces(*arrays_of(voxels), SIZE_M)
    named = {(*vertex, kind) for vertex, kind in zip(mesh.vertices_m.tolist(), mesh.classes.tolist(), strict=True)}  # type: ignore[misc]
    assert len(named) == len(mesh.vertices_m) == len(np.unique(mesh.triangles))


@given(worlds)
@settings(max_examples=40, deadline=None)
def test_a_coarser_voxel_has_the_highest_class_of_those_in_it(voxels: Voxels) -> None:
    keys, classes = coarser(*arrays_of(voxels))
    expected: Voxels = {}
    for (i, j, k), kind in voxels.items():
        expected[i >> 1, j >> 1, k >> 1] = max(kind, expected.get((i >> 1, j >> 1, k >> 1), 0))
    assert dict(zip(map(tuple, indices_of(keys).tolist()), classes.tolist(), strict=True)) == expected


def test_few_faces_are_few_and_lie_around_the_voxels() -> None:
    keys = keys_from_indices(np.argwhere(np.ones((40, 40, 1), np.bool_)).astype(np.int64))
    mesh = few_faces(keys, np.full(len(keys), 2, np.uint8), SIZE_M, 500)
    assert 0 < len(mesh.triangles) <= 500
    assert mesh.vertices_m.min(axis=0).tolist() == [0.0, 0.0, 0.0]
    assert (mesh.vertices_m.max(axis=0)[:2] == 40 * SIZE_M).all()


def test_the_corners_of_a_face_lie_in_one_plane() -> None:
    for side, corners in zip(SIDES, CORNERS, strict=True):
        along = corners @ np.array(side)
        assert (along == along[0]).all()
