import numpy as np
import pytest

from clothrf_core.errors import ShapeError
from clothrf_core.types import Action, CameraModel, ClothState, Features, GraspState, RgbdFrame


def camera(**changes):
    values = {"width": 8, "height": 6, "K": np.eye(3), "T_world_camera": np.eye(4), **changes}
    return CameraModel(**values)


def test_a_frame_of_another_size_than_its_camera_is_refused():
    with pytest.raises(ShapeError) as error:
        RgbdFrame(0, np.zeros((6, 8, 3), np.uint8), np.zeros((3, 8), np.float32), camera())
    assert str(error.value) == (
        "RgbdFrame.depth: expected float32 of shape (6, 8), got float32 of shape (3, 8)"
    )


def test_a_double_precision_depth_is_refused_not_cast():
    with pytest.raises(ShapeError, match="expected float32 .* got float64"):
        RgbdFrame(0, np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8)), camera())


def test_arrays_of_a_noun_cannot_be_written_to():
    grasp = GraspState(np.zeros((2, 3)), 0)
    with pytest.raises(ValueError, match="read-only"):
        grasp.positions[0, 0] = 1.0


def test_a_noun_does_not_lock_the_callers_array():
    positions = np.zeros((2, 3))
    GraspState(positions, 0)
    positions[0, 0] = 1.0
    assert positions[0, 0] == 1.0


def test_a_camera_pose_that_is_no_rotation_is_refused():
    T = np.eye(4)
    T[0, 0] = 1.1
    with pytest.raises(ShapeError, match="expected a rotation matrix"):
        camera(T_world_camera=T)


def test_a_mirrored_camera_pose_is_refused():
    with pytest.raises(ShapeError, match="expected a rotation matrix"):
        camera(T_world_camera=np.diag([1.0, 1.0, -1.0, 1.0]))


@pytest.mark.parametrize("count", [1, 3, 6])
def test_an_odd_number_of_distortion_coefficients_is_refused(count):
    with pytest.raises(ShapeError, match="expected 0, 4, 5 or 8 coefficients"):
        camera(distortion=np.zeros(count))


def test_features_need_one_name_a_value():
    with pytest.raises(ShapeError, match=r"Features.values: expected float32 of shape \(2\)"):
        Features(np.zeros(3, np.float32), ("a", "b"), np.zeros(3))


def test_velocities_must_fit_the_vertices():
    with pytest.raises(ShapeError, match=r"ClothState.velocities"):
        ClothState(np.zeros((5, 3)), np.zeros((4, 3)), np.zeros((2, 3)), np.zeros((2, 3)))


def test_holding_means_staying_with_no_confidence():
    grasp = GraspState(np.arange(6.0).reshape(2, 3), 5)
    action = Action.hold(grasp)
    assert np.array_equal(action.targets, grasp.positions)
    assert action.confidence == 0.0
