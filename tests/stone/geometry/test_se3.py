"""SE3 is a group, acts on points, and agrees with scipy on rotations and slerp."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation, Slerp

from stone.errors import ShapeError
from stone.geometry.placed_points import placed
from stone.geometry.se3 import SE3, interpolate, multiply, rotate, slerp, wxyz_from_rotation

TIGHT = 1e-9
batches = hnp.array_shapes(min_dims=0, max_dims=2, min_side=1, max_side=3)
quick = settings(max_examples=60, deadline=None)


@st.composite
def rotvecs(draw, batch):
    """Rotation vectors of every size, with the angles where formulas break drawn on purpose."""
    axis = draw(hnp.arrays(np.float64, (*batch, 3), elements=st.floats(-1, 1)))
    norm = np.linalg.norm(axis, axis=-1, keepdims=True)
    axis = np.where(norm > 1e-3, axis / np.maximum(norm, 1e-3), [0.0, 0.0, 1.0])
    edge = st.sampled_from([0.0, 1e-12, 1e-7, 1e-4, np.pi / 2, np.pi - 1e-4, np.pi - 1e-9, np.pi])
    return axis * draw(hnp.arrays(np.float64, (*batch, 1), elements=edge | st.floats(0, np.pi)))


def wxyz_of(rotvec):
    return np.roll(Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_quat(), 1, axis=-1).reshape(*rotvec.shape[:-1], 4)


def rotation_of(wxyz):
    return Rotation.from_quat(np.roll(wxyz.reshape(-1, 4), -1, axis=-1))


@st.composite
def transforms(draw, batch=None):
    shape = draw(batches) if batch is None else batch
    flip = draw(hnp.arrays(np.float64, (*shape, 1), elements=st.sampled_from([-1.0, 1.0])))
    translation = draw(hnp.arrays(np.float64, (*shape, 3), elements=st.floats(-1e3, 1e3)))
    return SE3.from_parts(wxyz_of(draw(rotvecs(shape))) * flip, translation)


@st.composite
def triples(draw):
    shape = draw(batches)
    return tuple(draw(transforms(shape)) for _ in range(3))


def assert_same(a: SE3, b: SE3, atol: float = 1e-8) -> None:
    np.testing.assert_allclose(a.as_matrix(), b.as_matrix(), atol=atol)


@pytest.mark.whole
@quick
@given(triples())
def test_transforms_are_a_group_that_acts_on_points_and_stay_unit(abc):
    a, b, c = abc
    assert_same((a @ b) @ c, a @ (b @ c))
    for same in (a @ SE3.identity(a.batch), SE3.identity() @ a):
        assert_same(same, a)
    for nothing in (a @ a.inverse(), a.inverse() @ a):
        assert_same(nothing, SE3.identity(a.batch))
    np.testing.assert_allclose((a @ b) @ c.translation_m, a @ (b @ c.translation_m), atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm((a @ a).wxyz, axis=-1), 1.0, atol=1e-12)


@quick
@given(transforms())
def test_rotation_and_matrix_agree_with_scipy(a):
    oracle = rotation_of(a.wxyz).as_matrix().reshape(*a.batch, 3, 3)
    np.testing.assert_allclose(a.rotation(), oracle, atol=TIGHT)
    np.testing.assert_allclose(a.as_matrix()[..., :3, :3], oracle, atol=TIGHT)
    np.testing.assert_array_equal(a.as_matrix()[..., :3, 3], a.translation_m)
    np.testing.assert_array_equal(a.as_matrix()[..., 3, :], np.broadcast_to([0, 0, 0, 1], (*a.batch, 4)))


@quick
@given(transforms())
def test_a_matrix_round_trips_at_every_angle(a):
    assert_same(SE3.from_matrix(a.as_matrix()), a, atol=1e-9)
    assert np.all(wxyz_from_rotation(a.rotation())[..., 0] >= 0)


@quick
@given(transforms(batch=(4,)), transforms(batch=(4,)))
def test_the_product_of_quaternions_is_scipys(a, b):
    oracle = (rotation_of(a.wxyz) * rotation_of(b.wxyz)).as_matrix()
    np.testing.assert_allclose(rotation_of(multiply(a.wxyz, b.wxyz)).as_matrix(), oracle, atol=TIGHT)
    np.testing.assert_allclose(rotate(a.wxyz, b.translation_m), rotation_of(a.wxyz).apply(b.translation_m), atol=1e-8)


@quick
@given(transforms(batch=()), transforms(batch=()), st.floats(0, 1))
def test_slerp_is_scipys_shortest_arc(a, b, ratio):
    # Half a turn apart there are two shortest arcs and either is right.
    assume(abs(float(np.dot(a.wxyz, b.wxyz))) > 1e-3)
    ends = Rotation.concatenate([rotation_of(a.wxyz), rotation_of(b.wxyz)])
    oracle = Slerp([0.0, 1.0], ends)([ratio])
    mixed = rotation_of(slerp(a.wxyz, b.wxyz, np.array(ratio)))
    assert (mixed * oracle.inv()).magnitude().max() < 1e-7


def test_two_degrees_across_a_sign_flip_meet_in_the_middle_at_one():
    start, end = wxyz_of(np.array([0, 0, 0.0])), -wxyz_of(np.array([0, 0, np.deg2rad(2)]))
    middle = rotation_of(slerp(start, end, np.array(0.5))).as_rotvec()[0]
    np.testing.assert_allclose(np.rad2deg(middle), [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 9.9e-7, 1.01e-6, 1e-3, 1.0, np.pi - 1e-6])
def test_slerp_turns_by_its_share_of_the_angle(angle):
    end = wxyz_of(np.array([0.0, angle, 0.0]))
    quarter = rotation_of(slerp(np.array([1.0, 0, 0, 0]), end, np.array(0.25))).magnitude()[0]
    assert quarter == pytest.approx(angle / 4, rel=1e-9, abs=1e-15)


@quick
@given(transforms(batch=(2,)), transforms(batch=(2,)))
def test_interpolation_starts_at_one_and_ends_at_the_other(a, b):
    assert_same(interpolate(a, b, np.zeros(2)), a)
    assert_same(interpolate(a, b, np.ones(2)), b)


@quick
@given(transforms(batch=(5,)))
def test_a_batch_acts_like_its_members(a):
    assert len(a) == 5
    assert_same(a[1:4] @ a[0], SE3(np.stack([(a[i] @ a[0]).wxyz_xyz for i in (1, 2, 3)])))
    assert_same(a[np.array([True, False, False, False, True])], a[np.array([0, 4])])


def test_another_length_is_refused():
    with pytest.raises(ShapeError):
        SE3(np.zeros(6))
    with pytest.raises(ShapeError):
        SE3.from_matrix(np.eye(3))


@settings(max_examples=60, deadline=None)
@given(transforms(batch=()))
def test_every_bit_is_that_of_the_pose_applied(pose: SE3) -> None:
    points = np.random.default_rng(3).normal(0.0, 20.0, (257, 3))
    points[0], points[1, 1] = 0.0, np.nan
    assert placed(pose, points).tobytes() == (pose @ points).tobytes()


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.arange(12.0).reshape(2, 6)[:, ::2], np.ones((3, 4)).T[:, :3]])
def test_no_points_and_points_that_do_not_lie_in_a_row(points: np.ndarray) -> None:
    pose = SE3(np.array([0.5, 0.5, -0.5, 0.5, 1.0, 2.0, 3.0]))
    assert (placed(pose, points) == pose @ points).all()
