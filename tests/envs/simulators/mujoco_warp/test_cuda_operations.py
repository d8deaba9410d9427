"""What a CPU computes and CUDA does not: found here, without a GPU."""

import numpy as np
import pytest
import torch
import warp as wp
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from envs.simulators.mujoco_warp.device import Device
from envs.simulators.mujoco_warp.handler import MujocoWarpHandler
from envs.spec import EnvSpec
from tests.envs.simulators.mujoco_warp.conftest import images_of, scene, starts

UNSIGNED = {torch.uint16: wp.uint16, torch.uint32: wp.uint32, torch.uint64: wp.uint64}
"""Types of integers on which CUDA has hardly an operation: no indexing, comparison or arithmetic."""

VIEWS = {
    torch.ops.aten.view.dtype,
    torch.ops.aten.detach.default,
    torch.ops.aten.alias.default,
    torch.ops.aten.lift_fresh.default,
}


class RefusesWhatCudaLacks(TorchDispatchMode):
    """Raises as CUDA does where an operation on unsigned integers is more than another view of them."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        given = [value for value in tree_leaves((args, kwargs)) if isinstance(value, torch.Tensor)]
        refused = {value.dtype for value in given} & UNSIGNED.keys()
        if refused and func not in VIEWS:
            raise NotImplementedError(f'"{func}" not implemented for {refused}')
        return func(*args, **(kwargs or {}))


def test_the_mode_refuses_what_cuda_refused():
    packed = torch.from_numpy(np.arange(4, dtype=np.uint32))
    with RefusesWhatCudaLacks():
        assert packed.view(torch.int32)[torch.tensor([2, 1])].tolist() == [2, 1]
        with pytest.raises(NotImplementedError, match=r"aten\.index\.Tensor"):
            packed[torch.tensor([2, 1])]


@pytest.mark.parametrize("unsigned", UNSIGNED)
def test_unsigned_arrays_become_signed_tensors_of_the_same_memory(unsigned):
    array = wp.array([1, 2], dtype=UNSIGNED[unsigned], device="cpu")
    tensor = Device("cpu").tensor(array)
    assert tensor.dtype.is_signed and tensor.dtype.itemsize == unsigned.itemsize
    tensor[1] = 5
    assert array.numpy().tolist() == [1, 5]


def test_physics_states_and_images_need_no_operation_that_cuda_lacks():
    with RefusesWhatCudaLacks(), MujocoWarpHandler(scene(), 2, textures=images_of) as handler:
        handler.launch()
        handler.set_states(starts(2))
        handler.step(2)
        handler.step(1, [1])
        assert handler.get_states([0]).num_envs == 1
        images = handler.render_tensors(None, None, ("rgb", "depth", "segmentation"))
        assert {name: image.dtype for name, image in images["front"].items()} == {
            "rgb": torch.uint8,
            "depth": torch.float32,
            "segmentation": torch.int32,
        }
        assert handler.render(env_ids=[1])["front"]["rgb"].std() > 10


def test_agents_that_see_images_need_no_operation_that_cuda_lacks():
    with RefusesWhatCudaLacks():
        spec = EnvSpec(task="control/cartpole", simulator="mujoco_warp", image_size=64)
        env = spec.make_torch(2, observation="pixels", num_frames=2, bank_size=4)
        step = env.step(torch.ones(2, 1))
        env.load_state_dict(env.state_dict())
        env.close()
    assert step.obs.dtype == torch.uint8
