"""Starts in the middle of CALVIN's chains: the recorded states, and what the simulator makes of them."""

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.experts.actor import expert_episodes
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.calvin import chain_states, memory
from envs.tasks.calvin.catalogue import BLOCKS, task_facts
from envs.tasks.calvin.chain_states import FILE, ChainStates, states_before
from envs.tasks.calvin.memory import ANY_BLOCK, PART_BITS, ROBOT_BIT
from envs.tasks.calvin.scene import DRAWER, ROBOT, SLIDE, SWITCH
from envs.tasks.calvin.sequences import after, start_symbols

KEYS = tuple(start_symbols()[0])


@pytest.fixture(scope="module")
def recorded():
    return ChainStates.load()


def column(recorded, key):
    return recorded.symbols[:, KEYS.index(key)]


def rngs(count, seed=0):
    return [np.random.default_rng([seed, index]) for index in range(count)]


@pytest.mark.parametrize("task", task_facts())
def test_the_symbols_of_many_recorded_states_let_every_task_be_done(task):
    states, rows = states_before(task)
    assert len(rows) >= 40 and len(set(rows.tolist())) == len(rows) and rows.max() < len(states.led)


@pytest.mark.parametrize(
    ("task", "touches", "left_out"),
    [
        ("push_into_drawer", lambda codes: (codes == PART_BITS["base"]).any(1), 37),
        ("unstack_block", lambda codes: ((codes & ANY_BLOCK > 0) & (codes & ~ANY_BLOCK == 0)).any(1), 7),
        ("lift_blue_block_table", lambda codes: codes[:, 1] & PART_BITS["base"] > 0, 8),
        ("place_in_slider", lambda codes: ((codes & ROBOT_BIT > 0).sum(1) == 1) & (codes == 1).any(1), 0),
    ],
)
def test_states_whose_contacts_rule_a_task_out_are_not_before_it(recorded, task, touches, left_out):
    _, rows = states_before(task)
    symbols = map(chain_states._symbols, recorded.symbols.tolist())
    by_symbols = [row for row, before in enumerate(symbols) if after(before, task)]
    assert sorted(set(by_symbols) - set(rows)) == [
        row for row in by_symbols if not touches(recorded.touches[[row]].astype(int))[0]
    ]
    assert len(by_symbols) - len(rows) == left_out


def test_recorded_text_becomes_the_symbols_that_the_rules_of_tasks_read():
    text = ["1", "0", "left", "open", "grasped", "drawer", "slider_left", "1"]
    assert chain_states._symbols(text) == {
        "led": 1,
        "lightbulb": 0,
        "slider": "left",
        "drawer": "open",
        "red_block": "grasped",
        "blue_block": "drawer",
        "pink_block": "slider_left",
        "grasped": 1,
    }


def test_the_recorded_scene_is_what_the_symbols_say(recorded):
    np.testing.assert_array_equal(recorded.table[:, DRAWER] > 0.1, column(recorded, "drawer") == "open")
    np.testing.assert_array_equal(
        recorded.table[:, SWITCH] > memory.SWITCH_ON_M, column(recorded, "lightbulb") == "1"
    )
    np.testing.assert_array_equal(recorded.led, column(recorded, "led") == "1")
    left = column(recorded, "slider") == "left"
    assert np.mean(recorded.table[left, SLIDE] > 0.15) > 0.99 < np.mean(recorded.table[~left, SLIDE] < 0.13)
    for index, colour in enumerate(BLOCKS):
        held = column(recorded, f"{colour}_block") == "grasped"
        touched = recorded.touches[:, index]
        assert (touched[held] & ROBOT_BIT).all() and held.sum() > 50
        in_drawer = column(recorded, f"{colour}_block") == "drawer"
        assert (touched[in_drawer] & PART_BITS["drawer"]).all() and in_drawer.sum() > 50


def test_states_are_the_same_after_saving_and_loading(recorded, tmp_path):
    recorded.save(tmp_path / "states.npz")
    again = ChainStates.load(tmp_path / "states.npz")
    for name in ChainStates.__slots__:
        np.testing.assert_array_equal(getattr(again, name), getattr(recorded, name))
    assert FILE.stat().st_size < 1_000_000


def test_a_recorded_state_becomes_a_start_whose_memory_is_of_itself(recorded):
    rows = np.array([0, 7])
    state = recorded.state(rows, ROBOT)
    arm = state.robots[ROBOT.name]
    np.testing.assert_allclose(arm.joint_pos.numpy(), recorded.qpos[rows])
    assert arm.joint_target is not None
    np.testing.assert_allclose(arm.joint_target.numpy(), recorded.targets[rows])
    for index, colour in enumerate(BLOCKS):
        block, start = state.objects[f"block_{colour}"], memory.start_block(state, colour)
        np.testing.assert_allclose(block.pos.numpy(), recorded.blocks[rows, index, :3])
        assert torch.equal(block.pos, start.pos) and torch.equal(block.rot, start.rot)
        np.testing.assert_allclose(block.rot.norm(dim=-1), 1.0)
        assert memory.start_touches(state, colour).tolist() == recorded.touches[rows, index].tolist()
    assert [light.tolist() for light in memory.led(state)] == [recorded.led[rows].tolist()] * 2
    assert torch.equal(memory.start_joints(state), memory.joints(state))


def test_a_fifth_of_the_starts_of_a_chain_are_its_first():
    task = TASKS.get("calvin/D/open_drawer")(starts="chain")
    state = task.initial_state(rngs(400))
    rest = np.array(ROBOT.default_qpos)[list(ROBOT.arm)]
    arms = state.robots[ROBOT.name].joint_pos[:, list(ROBOT.arm)].numpy()
    near = np.abs(arms - rest).max(1) < 0.05  # five standard deviations of the start
    assert 0.15 < near.mean() < 0.25


def test_the_start_of_an_episode_does_not_depend_on_those_beside_it():
    task = TASKS.get("calvin/D/place_in_slider")(starts="chain")
    both, alone = task.initial_state(rngs(6)), task.initial_state(rngs(6)[4:5])
    for key, value in alone.flatten().items():
        assert torch.equal(both.flatten()[key][4:5], value), key


@pytest.mark.parametrize(("task", "robot"), [("calvin/A/open_drawer", ""), ("calvin/D/open_drawer", "ur5e")])
def test_other_scenes_and_robots_have_no_starts_in_a_chain(task, robot):
    with pytest.raises(
        ConfigError, match=r"recorded in scene D with CALVIN's own robot.*task_kwargs\.starts"
    ):
        EnvSpec(task=task, task_kwargs={"starts": "chain"}, robot=robot).make_task()


@pytest.mark.slow
@pytest.mark.parametrize(
    "task", ["lift_pink_block_slider", "place_in_drawer", "push_pink_block_left", "close_drawer"]
)
def test_the_expert_goes_on_from_where_another_task_ended(task):
    spec = EnvSpec(task=f"calvin/D/{task}", task_kwargs={"starts": "chain"})
    env = spec.make(10, observation="state")
    try:
        solved = [e.success for e in expert_episodes(env, env.split_indices[:20].tolist(), record=())]
    finally:
        env.close()
    assert sum(solved) >= 17
