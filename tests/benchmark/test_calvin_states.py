"""States in the middle of CALVIN's chains: those that the expert's chains are seen in."""

import numpy as np
import pytest

from benchmark import calvin_states
from benchmark.calvin_chains import ENV_TASK
from benchmark.calvin_states import drawn_chain, found_states
from envs.spec import EnvSpec
from envs.tasks.calvin.chain_states import ChainStates
from envs.tasks.calvin.memory import ROBOT_BIT
from envs.tasks.calvin.sequences import all_chains, chain_is_valid


def test_chains_are_valid_and_none_is_one_of_the_evaluation():
    chains = [drawn_chain(index, seed=0) for index in range(30)]
    assert all(chain_is_valid(symbols, tasks) for symbols, tasks in chains)
    assert not [chain for chain in chains if chain in all_chains()]
    assert drawn_chain(3, seed=0) == chains[3] != drawn_chain(3, seed=1)


@pytest.mark.slow
def test_the_state_after_every_task_of_a_chain_is_found(monkeypatch):
    five = ("lift_red_block_table", "place_in_slider", "open_drawer", "turn_on_led", "move_slider_left")
    symbols = dict(all_chains()[0][0]) | {
        "red_block": "table",
        "blue_block": "table",
        "pink_block": "slider_left",
    }
    symbols |= {"drawer": "closed", "led": 0, "slider": "right"}
    assert chain_is_valid(symbols, five)
    monkeypatch.setattr(calvin_states, "drawn_chain", lambda index, seed: (symbols, five))
    env = EnvSpec(task=ENV_TASK).make(2, observation="state", num_threads=1)
    try:
        states = found_states(env, [0, 1])
        alone = found_states(env, [1])
    finally:
        env.close()
    assert len(states.led) == 10 and states.led[:5].tolist() == [False, False, False, True, True]
    assert states.touches[0, 0] & ROBOT_BIT and not states.touches[1, 0] & ROBOT_BIT
    assert states.symbols[2].tolist()[2:5] == ["right", "open", "slider_right"]
    assert states.table[2, 1] > 0.1 > states.table[1, 1]
    for name in ChainStates.__slots__:  # a chain does not depend on those beside it
        np.testing.assert_array_equal(getattr(states, name)[5:], getattr(alone, name))
