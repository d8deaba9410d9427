"""Warp's launches that are packed once."""

import dataclasses
import threading

import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp

from envs.mjcf.model import build_model
from envs.simulators.mujoco.render import RenderJob
from envs.simulators.mujoco.render_warp import WarpRenderer
from envs.simulators.mujoco.warp_launches import Launches
from envs.tasks.pick_cube import PickCube


@wp.kernel
def _add(value: wp.array[float], total: wp.array[float]):
    i = wp.tid()
    total[i] = total[i] + value[i]


def _add_to(total: wp.array, value: float) -> wp.array:
    given = wp.full(3, value, dtype=float, device="cpu")
    wp.launch(_add, dim=3, inputs=[given], outputs=[total], device="cpu")
    return given


@pytest.fixture
def total() -> wp.array:
    return wp.zeros(3, dtype=float, device="cpu")


def test_launches_run_when_they_are_recorded_and_each_time_they_are_launched(total):
    launches = Launches(lambda: (_add_to(total, 1.0), _add_to(total, 10.0)))
    assert total.numpy().tolist() == [11.0] * 3
    launches.launch()
    launches.launch()
    assert total.numpy().tolist() == [33.0] * 3


def test_launches_read_what_is_in_their_arrays_now(total):
    arrays = []
    launches = Launches(lambda: arrays.append(_add_to(total, 1.0)))
    arrays[0].numpy()[:] = [2.0, 3.0, 4.0]
    launches.launch()
    assert total.numpy().tolist() == [3.0, 4.0, 5.0]


def test_an_argument_is_replaced_in_all_kernels_that_have_it(total):
    launches = Launches(lambda: (_add_to(total, 1.0), _add_to(total, 1.0)))
    launches.replace("value", wp.full(3, 5.0, dtype=float, device="cpu"))
    launches.launch()
    assert total.numpy().tolist() == [12.0] * 3
    with pytest.raises(KeyError, match="texture"):
        launches.replace("texture", None)


def test_launches_of_another_size(total):
    launches = Launches(lambda: _add_to(total, 1.0))
    launches.resize((2,))
    launches.launch()
    assert total.numpy().tolist() == [2.0, 2.0, 1.0]


def test_launches_of_other_threads_are_not_recorded(total):
    other = wp.zeros(3, dtype=float, device="cpu")

    def both() -> None:
        thread = threading.Thread(target=_add_to, args=(other, 1.0))
        thread.start()
        thread.join()
        _add_to(total, 1.0)

    Launches(both).launch()
    assert np.array_equal(total.numpy(), [2.0] * 3)
    assert np.array_equal(other.numpy(), [1.0] * 3)


def test_launching_is_as_before_after_an_error_while_recording(total):
    launch = wp.launch

    def fail() -> None:
        raise RuntimeError("no kernel")

    with pytest.raises(RuntimeError, match="no kernel"):
        Launches(fail)
    assert wp.launch is launch


@pytest.mark.slow
def test_a_trace_is_what_mujoco_warp_renders():
    """It does all that ``refit_bvh`` and ``render`` do, after the scene has moved and with every modality."""
    scenario = PickCube().scenario
    cameras = tuple(dataclasses.replace(camera, width=32, height=32) for camera in scenario.cameras)
    scenario = dataclasses.replace(scenario, cameras=cameras)
    model = build_model(scenario)
    renderer = WarpRenderer(model, scenario, num_threads=1)
    modalities, names = ("rgb", "depth", "segmentation"), tuple(camera.name for camera in cameras)
    for turn in (0.0, 0.5, 0.7):  # radians of a joint of the arm
        qpos = model.qpos0.copy()
        qpos[1] += turn
        job = RenderJob(qpos, np.zeros((model.nmocap, 3)), np.zeros((model.nmocap, 4)), scenario.appearance)
        drawn = renderer.render([job], names, modalities)
    tracer = renderer._idle[(names, modalities)].get()
    room = tracer._room
    room._pixels.choose(None)
    for array in (room.context.rgb_data, room.context.depth_data, room.context.seg_data):
        array.zero_()
    mjw.refit_bvh(tracer._model, tracer._data, room.context)
    mjw.render(tracer._model, tracer._data, room.context)
    expected = renderer.empty(1, names, modalities)
    tracer._fetch(room.images, expected, 0)
    for name in names:
        for kind in modalities:
            assert np.array_equal(drawn[name][kind], expected[name][kind])
    renderer.close()
