"""Vertex normals against a loop over faces."""

import numpy as np

from stone.surface.mesh import Mesh, vertex_normals


def fan(rng, spokes=7):
    """A bumpy disk around vertex 0."""
    angle = np.linspace(0, 2 * np.pi, spokes, endpoint=False)
    rim = np.column_stack([np.cos(angle), np.sin(angle), rng.normal(0, 0.3, spokes)])
    triangles = [[0, 1 + i, 1 + (i + 1) % spokes] for i in range(spokes)]
    return Mesh(np.concatenate([np.zeros((1, 3)), rim]), np.array(triangles, np.int32))


def normals_slowly(mesh):
    sums = np.zeros_like(mesh.vertices_map)
    for face in mesh.triangles:
        a, b, c = mesh.vertices_map[face]
        normal = np.cross(b - a, c - a)
        for vertex in face:
            sums[vertex] += normal / np.linalg.norm(normal)
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def test_a_normal_is_the_mean_of_the_faces_around():
    mesh = fan(np.random.default_rng(1))
    np.testing.assert_allclose(vertex_normals(mesh), normals_slowly(mesh), atol=1e-14)


def test_counter_clockwise_is_up_and_clockwise_down():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert (vertex_normals(Mesh(corners, np.array([[0, 1, 2]], np.int32))) == [0, 0, 1]).all()
    assert (vertex_normals(Mesh(corners, np.array([[0, 2, 1]], np.int32))) == [0, 0, -1]).all()


def test_degenerate_faces_and_lonely_vertices_count_for_nothing():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [9, 9, 9]])
    normals = vertex_normals(Mesh(corners, np.array([[0, 1, 2], [0, 1, 3]], np.int32)))
    assert normals.tolist() == [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 0], [0, 0, 0]]


def test_a_kept_triangle_keeps_its_corners():
    mesh = fan(np.random.default_rng(2))
    keep = np.ones(8, np.bool_)
    keep[3] = False
    kept = mesh.where(keep)
    whole = [face for face in mesh.triangles if 3 not in face]
    assert len(kept.triangles) == len(whole) == 5
    np.testing.assert_array_equal(kept.vertices_map[kept.triangles], mesh.vertices_map[np.array(whole)])


def test_a_mesh_may_lose_everything():
    nothing = fan(np.random.default_rng(3)).where(np.zeros(8, np.bool_))
    assert nothing.vertices_map.shape == nothing.triangles.shape == (0, 3)
    assert nothing.where(np.zeros(0, np.bool_)).triangles.shape == (0, 3)
