"""One function for arrays and for tensors: both give the same numbers."""

import numpy as np
import pytest
import torch

from envs.array_ops import (
    at_least,
    concatenate,
    constant,
    filled,
    largest,
    norm,
    stack,
    tanh,
    to_numpy,
    where,
    within,
)

VALUES = np.array([[0.3, -1.2, 2.0], [0.0, 4.0, -3.0]])


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (norm, np.sqrt((VALUES**2).sum(-1))),
        (tanh, np.tanh(VALUES)),
        (largest, [2.0, 4.0]),
        (lambda values: at_least(values, 0.0), VALUES.clip(min=0.0)),
        (lambda values: stack((values, values)), [VALUES, VALUES]),
        (lambda values: concatenate((values, values[:, :1])), np.hstack([VALUES, VALUES[:, :1]])),
        (lambda values: filled(values, values < 0.0, 9.0), np.where(VALUES < 0.0, 9.0, VALUES)),
        (lambda values: where(values < 0.0, 1.0, values), np.where(VALUES < 0.0, 1.0, VALUES)),
        (lambda values: within(values, -1.0, 2.0), VALUES.clip(-1.0, 2.0)),
        (lambda values: values + constant((1.0, 2.0, 3.0), values), np.add(VALUES, (1.0, 2.0, 3.0))),
    ],
    ids=[
        *("norm", "tanh", "largest", "at_least", "stack", "concatenate", "filled"),
        *("where", "within", "constant"),
    ],
)
def test_arrays_give_arrays_and_tensors_tensors(function, expected):
    of_array, of_tensor = function(VALUES), function(torch.from_numpy(VALUES))
    assert isinstance(of_array, np.ndarray) and isinstance(of_tensor, torch.Tensor)
    np.testing.assert_allclose(of_array, expected, rtol=1e-15)
    np.testing.assert_allclose(to_numpy(of_tensor), of_array, rtol=1e-15)


def test_to_numpy_leaves_an_array_as_it_is():
    assert to_numpy(VALUES) is VALUES


def test_constants_have_the_precision_of_what_they_are_for():
    assert constant((1.0,), VALUES.astype(np.float32)).dtype == np.float32
    assert constant((1.0,), torch.zeros(1, dtype=torch.float16)).dtype == torch.float16
