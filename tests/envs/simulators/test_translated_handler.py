"""Simulators of compiled models, tested with a fake world that records its calls."""

import numpy as np
import pytest
import torch

from envs.core.errors import SimulatorError, UnknownNameError
from envs.simulators.mujoco.handler import MujocoHandler
from envs.simulators.translated_handler import TranslatedHandler, World
from envs.tasks.close_box import CloseBox
from envs.tasks.pick_cube import PickCube

NUM_ENVS = 3


class Ledger(World):
    """Records its calls; a step moves the first number of the state by a millimetre."""

    def __init__(self):
        self.calls = []

    def put(self, qpos, qvel, ctrl):
        self.calls.append("put")
        self._qpos, self._qvel = qpos.copy(), qvel.copy()

    def place(self, mocap_pos, mocap_quat):
        self.calls.append("place")

    def drive(self, ctrl):
        self.calls.append(("drive", ctrl.copy()))

    def step(self, num_steps):
        self.calls.append(("step", num_steps))
        self._qpos[0] += 0.001 * num_steps

    def read(self, qpos, qvel):
        qpos[:], qvel[:] = self._qpos, self._qvel

    def close(self):
        self.calls.append("close")


class LedgerHandler(TranslatedHandler):
    def make_worlds(self, model):
        return [Ledger() for _ in range(self.num_envs)]


def launched(scenario, kind=LedgerHandler):
    handler = kind(scenario, NUM_ENVS, renderer="warp")
    handler.launch()
    return handler


def starts(task, count=NUM_ENVS):
    return task.initial_state([np.random.default_rng(i) for i in range(count)])


@pytest.fixture(params=[PickCube, CloseBox])
def task(request):
    return request.param()


def test_its_states_are_mujocos(task):
    """The same state set in both: every field of every entity is the same, end effector and rest included."""
    with launched(task.scenario) as ours, launched(task.scenario, MujocoHandler) as theirs:
        for handler in (ours, theirs):
            handler.set_states(starts(task))
        for rows in (None, [2, 0], np.array([1])):
            expected = theirs.get_states(rows).flatten()
            given = ours.get_states(rows).flatten()
            assert set(given) == set(expected)
            for key, value in given.items():
                assert value.dtype == torch.float32
                assert value.shape == expected[key].shape, key
                torch.testing.assert_close(value.double(), expected[key], atol=2e-6, rtol=0.0, msg=key)


def test_what_was_read_stays_what_it_was(task):
    with launched(task.scenario) as handler:
        handler.set_states(starts(task))
        whole, some = handler.get_states(), handler.get_states([1])
        kept = [{k: v.clone() for k, v in state.flatten().items()} for state in (whole, some)]
        handler.set_states(starts(task).select([2, 1, 0]))
        handler.step(4)
        for state, before in zip((whole, some), kept, strict=True):
            for key, value in state.flatten().items():
                assert torch.equal(value, before[key]), key


def test_only_selected_environments_are_stepped_and_targets_come_first():
    task = PickCube()
    with launched(task.scenario) as handler:
        worlds = handler.worlds
        for world in worlds:
            world.calls.clear()
        handler.step(5, [1])
        assert [[entry if isinstance(entry, str) else entry[0] for entry in w.calls] for w in worlds] == [
            [],
            ["drive", "step"],
            [],
        ]
        assert worlds[1].calls[1] == ("step", 5)


def test_targets_move_evenly_and_arrive():
    task = PickCube()
    with launched(task.scenario) as handler:
        handler.set_states(starts(task))
        before = handler.get_joint_targets("franka")[0].numpy()
        world = handler.worlds[0]
        world.calls.clear()
        handler.step_towards({"franka": before[None] + 0.01}, 4, [0])
        driven = [entry[1] for entry in world.calls if entry[0] == "drive"]
        assert len(driven) == 4
        np.testing.assert_allclose(np.diff([before, *driven], axis=0)[:, :7], 0.0025, atol=1e-6)
        np.testing.assert_array_equal(driven[-1], handler.get_joint_targets("franka")[0].numpy())


def test_what_is_not_placed_is_refused_by_name():
    with launched(PickCube().scenario) as handler:
        pose = (torch.zeros((1, 3)), torch.tensor([[1.0, 0.0, 0.0, 0.0]]))
        with pytest.raises(
            UnknownNameError, match=r"Unknown fixed object or marker 'gaol'.*Did you mean 'goal'"
        ):
            handler.set_poses({"gaol": pose})


def test_a_state_that_is_no_number_names_its_environments():
    with launched(PickCube().scenario) as handler:
        handler.worlds[2]._qpos[3] = np.nan
        with pytest.raises(SimulatorError, match=r"environments \[2\] is no longer finite"):
            handler.step(1)


def test_closing_closes_every_world_once():
    handler = launched(PickCube().scenario)
    worlds = handler.worlds
    handler.close()
    handler.close()
    assert [world.calls.count("close") for world in worlds] == [1] * NUM_ENVS
