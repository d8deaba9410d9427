"""Quaternions against hand-computed values and the group's axioms."""

import numpy as np
import pytest
import torch

from envs import rotations as r

HALF = np.sqrt(0.5)


def random_quaternions(count=50):
    q = np.random.default_rng(0).normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def test_a_quarter_turn_about_z_takes_x_to_y():
    q = np.array([HALF, 0, 0, HALF])
    np.testing.assert_allclose(r.rotate(q, np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-15)
    assert r.yaw_of(q) == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(r.from_yaw(np.pi / 2), q)
    np.testing.assert_allclose(r.to_matrix(q), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


def test_products_compose_and_conjugates_invert():
    p, q = random_quaternions(), random_quaternions()[::-1].copy()
    v = np.random.default_rng(1).normal(size=(50, 3))
    np.testing.assert_allclose(r.rotate(r.multiply(p, q), v), r.rotate(p, r.rotate(q, v)), atol=1e-12)
    np.testing.assert_allclose(r.rotate(r.conjugate(p), r.rotate(p, v)), v, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", r.to_matrix(p), v), r.rotate(p, v), atol=1e-12)


def test_torch_and_numpy_agree():
    p, v = random_quaternions(), np.random.default_rng(2).normal(size=(50, 3))
    tp, tv = torch.from_numpy(p), torch.from_numpy(v)
    np.testing.assert_allclose(r.rotate(tp, tv).numpy(), r.rotate(p, v), atol=1e-14)
    np.testing.assert_allclose(r.multiply(tp, tp).numpy(), r.multiply(p, p), atol=1e-14)
    np.testing.assert_allclose(r.yaw_of(tp).numpy(), r.yaw_of(p), atol=1e-14)
    np.testing.assert_allclose(r.to_matrix(tp).numpy(), r.to_matrix(p), atol=1e-14)
    yaw = np.linspace(-4.0, 4.0, 12).reshape(3, 4)
    np.testing.assert_allclose(r.from_yaw(torch.from_numpy(yaw)).numpy(), r.from_yaw(yaw), atol=1e-14)


def test_a_turn_stays_on_its_device_and_keeps_its_type():
    """The meta device has no values: code that synchronizes fails there."""
    yaw = torch.zeros(5, dtype=torch.float32, device="meta")
    matrix = r.to_matrix(r.from_yaw(yaw))
    assert (matrix.device.type, matrix.dtype, matrix.shape) == ("meta", torch.float32, (5, 3, 3))


def test_a_camera_looks_along_minus_z_with_the_world_upright():
    matrix = r.look_at_matrix(np.array([2.0, 0, 1.0]), np.array([0.0, 0, 1.0]))
    np.testing.assert_allclose(matrix[:, 2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(matrix[:, 1], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(matrix[:, 0], [0, 1, 0], atol=1e-12)


def test_looking_straight_down_has_an_up_too():
    matrix = r.look_at_matrix(np.array([0.0, 0, 2.0]), np.zeros(3))
    np.testing.assert_allclose(matrix.T @ matrix, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix[:, 1], [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_matrix_round_trips_to_its_quaternion(kind):
    """Half turns about each axis too, where one of the four ways to write it divides by nothing."""
    q = np.random.default_rng(0).normal(size=(50, 4))
    q = np.concatenate([np.eye(4), q / np.linalg.norm(q, axis=-1, keepdims=True)])
    q *= np.sign(np.take_along_axis(q, np.abs(q).argmax(-1)[:, None], axis=-1))
    given = q if kind == "numpy" else torch.from_numpy(q)
    back = r.from_matrix(r.to_matrix(given))
    assert type(back) is type(given)
    np.testing.assert_allclose(back, q, atol=1e-12)


@pytest.mark.parametrize("kind", [float, np.array, torch.tensor])
def test_an_angle_is_wrapped_to_half_a_turn_either_way(kind):
    for angle, wrapped in (
        (0.5, 0.5),
        (np.pi, -np.pi),
        (-np.pi - 0.1, np.pi - 0.1),
        (14.0, 14.0 - 4 * np.pi),
    ):
        assert float(r.wrapped(kind(angle))) == pytest.approx(wrapped, abs=1e-5)
