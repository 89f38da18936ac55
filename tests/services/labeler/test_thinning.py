"""A thinned surface: few enough triangles, in the same place, facing the same way, of the same classes."""

import numpy as np
import pytest
from numpy.typing import NDArray

from services.domain.viewer.formats import TileMesh
from services.labeler.map.scene_files import MOST_PACKED, _each_once, thinned


def sheet(side: int, cell_m: float = 0.2) -> TileMesh:
    """A gently waved sheet of 2·(side−1)² triangles that face up, T in the west and N in the east."""
    i, j = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    x, y = i.ravel() * cell_m, j.ravel() * cell_m
    corner = (i[:-1, :-1] * side + j[:-1, :-1]).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + side, corner + 1], 1), np.stack([corner + 1, corner + side, corner + side + 1], 1)]
    )
    classes = np.where(x < x.max() / 2, 1, 3).astype(np.uint8)
    return TileMesh(np.stack([x, y, 0.2 * np.sin(x / 3)], 1), classes, triangles.astype(np.int32))


def normals(mesh: TileMesh) -> NDArray[np.float64]:
    a, b, c = (mesh.vertices_m[mesh.triangles[:, corner]] for corner in range(3))
    return np.asarray(np.cross(b - a, c - a), dtype=np.float64)


def test_few_triangles_are_left_as_they_are() -> None:
    mesh = sheet(10)
    assert thinned(mesh, 162) is mesh


@pytest.mark.parametrize("most", [5000, 800, 100])
def test_many_become_few_that_lie_where_they_lay_and_show_the_same_side(most: int) -> None:
    mesh = sheet(80)
    thin = thinned(mesh, most)
    assert most / 3 < len(thin.triangles) <= most
    assert (normals(thin)[:, 2] > 0).all()
    area = 0.5 * np.linalg.norm(normals(thin), axis=1).sum()
    assert area == pytest.approx(0.5 * np.linalg.norm(normals(mesh), axis=1).sum(), rel=0.25)
    surface = 0.2 * np.sin(thin.vertices_m[:, 0] / 3)
    assert np.abs(thin.vertices_m[:, 2] - surface).max() < 0.06
    assert set(np.unique(thin.triangles)) == set(range(len(thin.vertices_m)))


def test_a_cell_has_the_class_of_most_and_none_only_where_all_have_none() -> None:
    vertices = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [1, 0, 0], [1, 0.1, 0], [0, 1, 0], [0, 1.1, 0]], float)
    classes = np.array([3, 2, 2, 0, 1, 0, 0], np.uint8)
    triangles = np.array([[0, 3, 5], [1, 4, 6], [0, 1, 2]], np.int32)
    thin = thinned(TileMesh(vertices, classes, triangles), 1)
    assert thin.triangles.shape == (1, 3), "one that is flat, and one that is there twice, are gone"
    found = {tuple(place.round(2)): int(kind) for place, kind in zip(thin.vertices_m, thin.classes, strict=True)}
    assert found == {(0.07, 0.03, 0.0): 2, (1.0, 0.05, 0.0): 1, (0.0, 1.05, 0.0): 0}


@pytest.mark.parametrize("last", [9, MOST_PACKED - 1, MOST_PACKED, 2**40])
def test_each_triangle_is_kept_once_whatever_the_numbers_of_its_corners(last: int) -> None:
    corners = np.array([[last, 4, 7], [4, 7, last], [1, 4, 7], [7, last, 4], [7, 4, last], [4, 7, 1]])
    assert _each_once(corners).tolist() == [[1, 4, 7], [4, 7, last], [4, last, 7]]
    assert _each_once(corners[:0]).shape == (0, 3)
