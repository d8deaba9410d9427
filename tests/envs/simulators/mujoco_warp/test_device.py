"""What Warp and torch share: memory, a stream, and launches that are recorded once."""

import pytest
import torch
import warp as wp

from envs.core.errors import SimulatorError
from envs.simulators.mujoco_warp.device import Device


@wp.kernel
def _double(values: wp.array[float]):
    index = wp.tid()
    values[index] = 2.0 * values[index]


@pytest.fixture
def device():
    return Device("cpu")


def test_the_cpu_is_taken_where_there_is_no_gpu(device):
    chosen = Device("auto")
    assert chosen.is_cuda == torch.cuda.is_available()
    assert device.torch == torch.device("cpu")
    assert str(device.warp) == "cpu"


def test_an_unknown_device_is_refused_with_the_known_ones():
    with pytest.raises(
        SimulatorError, match=r"no device 'gpu' for simulator=mujoco_warp here\. Valid: auto, cpu"
    ):
        Device("gpu")


def test_a_tensor_is_the_arrays_own_memory(device):
    with device.scope():
        array = wp.zeros((2, 3), dtype=wp.vec3)
    tensor = device.tensor(array)
    assert tensor.shape == (2, 3, 3)
    tensor[1, 2] = torch.tensor([1.0, 2.0, 3.0])
    assert array.numpy()[1, 2].tolist() == [1.0, 2.0, 3.0]


def test_an_empty_array_is_an_empty_tensor(device):
    """Warp has no memory to share then; a scene without mocap bodies has such an array."""
    with device.scope():
        array = wp.zeros((4, 0), dtype=wp.quat)
    assert device.tensor(array).shape == (4, 0, 4)


def test_a_recording_does_nothing_until_it_is_replayed(device):
    with device.scope():
        array = wp.ones(3, dtype=float)
    graph = device.capture(lambda: wp.launch(_double, dim=3, inputs=[array]))
    assert array.numpy().tolist() == [1.0, 1.0, 1.0]
    graph.launch(3)
    assert array.numpy().tolist() == [8.0, 8.0, 8.0]
    device.tensor(array)[1] = 0.5
    graph.launch()
    assert array.numpy().tolist() == [16.0, 1.0, 16.0]


def test_rows_are_everything_or_a_long_tensor(device):
    assert device.rows(None) == slice(None)
    assert torch.equal(device.rows([3, 1]), torch.tensor([3, 1]))
    assert torch.equal(device.rows(range(2)), torch.tensor([0, 1]))
