"""Which instructions are wrong in whose scene, and what holding still is in each action space."""

from dataclasses import replace

import numpy as np
import pytest

from envs.core.errors import ConfigError, MissingExtraError
from envs.randomization.language import load_grammar
from envs.spec import EnvSpec
from policies.learned_tasks import LAST, UNRELATED, ZERO, Instructions, LearnedTask
from roboverse_learn.commands.run_identity import identity, run_name
from roboverse_learn.config.compose import compose
from roboverse_learn.training.imitation.wordings import with_bank_wordings
from roboverse_learn.training.imitation.wrong_instructions import still_of, with_wrong_instructions
from roboverse_learn.training.learners import learner_of

NAMES = ("PickCube", "StackCube", "MoveSliderLeft")


def task_of(name: str, **kwargs):
    task = EnvSpec(task=name, task_kwargs=kwargs).make_task()
    try:
        assert task.scenario.robots, name
    except MissingExtraError as error:
        pytest.skip(str(error))
    return task


def learned(task) -> LearnedTask:
    states, actions = tuple(task.state_names), tuple(task.controller.names)
    return LearnedTask(
        name=task.name,
        state_size=len(states),
        action_size=len(actions),
        state_names=states,
        action_names=actions,
    )


@pytest.fixture(scope="module")
def tasks():
    return {name: task_of(name) for name in NAMES}


@pytest.fixture(scope="module")
def own(tasks):
    texts = tuple(text for task in tasks.values() for text in task.instructions)
    task_of = tuple(number for number, task in enumerate(tasks.values()) for _ in task.instructions)
    return Instructions(texts=texts, tasks=tuple(map(learned, tasks.values())), task_of=task_of)


def wrong_texts(found: Instructions, name: str) -> set[str]:
    (wrong,) = (wrong for wrong, task in zip(found.wrong, found.tasks, strict=True) if task.name == name)
    return {found.texts[index] for index in wrong}


def test_instructions_of_another_task_are_wrong_unless_they_may_mean_the_same(tasks, own):
    found = with_wrong_instructions(own, tasks)
    assert found.texts[: len(own.texts)] == own.texts
    assert found.task_of[: len(own.texts)] == own.task_of
    cube, slider = (wrong_texts(found, name) for name in ("PickCube", "MoveSliderLeft"))
    assert {*tasks["MoveSliderLeft"].instructions} <= cube
    assert not cube & {*tasks["PickCube"].instructions}
    assert not cube & {*tasks["StackCube"].instructions}  # pick up the red cube and put it on ...
    assert {*tasks["PickCube"].instructions, *tasks["StackCube"].instructions} <= slider


def test_unrelated_instructions_name_no_object_of_the_task_and_no_held_out_word(tasks, own):
    found, grammar = with_wrong_instructions(own, tasks), load_grammar()
    unrelated = [text for text, of in zip(found.texts, found.task_of, strict=True) if of == UNRELATED]
    assert len(unrelated) == len(set(unrelated)) > 1000
    assert "open the microwave" in unrelated and "lift the cube" in unrelated
    assert "lift the cube" not in wrong_texts(found, "PickCube")
    assert {"lift the cube", "open the microwave"} <= wrong_texts(found, "MoveSliderLeft")
    held_out = {word for group in grammar.synonyms for word in group.new}
    assert not held_out & {word for text in unrelated for word in text.split()}


def test_unrelated_instructions_have_frames_where_the_tasks_own_have(tasks, own):
    found = with_wrong_instructions(with_bank_wordings(own), tasks)
    unrelated = [text for text, of in zip(found.texts, found.task_of, strict=True) if of == UNRELATED]
    assert any(text.startswith("can you please ") for text in unrelated)
    held_out = [frame.split("{x}")[0].strip() for frame in load_grammar().test_frames]
    assert not any(frame and text.startswith(frame) for text in unrelated for frame in held_out)


def test_tasks_of_one_scene_are_not_wrong_there():
    names = ("libero/goal/open_the_middle_drawer_of_the_cabinet", "libero/goal/turn_on_the_stove", "PickCube")
    tasks = {name: task_of(name) for name in names}
    each = tuple(map(learned, tasks.values()))
    texts = tuple(task.description for task in tasks.values())
    found = with_wrong_instructions(Instructions(texts=texts, tasks=each, task_of=(0, 1, 2)), tasks)
    assert texts[1] not in wrong_texts(found, names[0]) and texts[2] in wrong_texts(found, names[0])


def test_joint_targets_are_the_present_joints_and_the_last_of_the_gripper():
    task = task_of("PickCube")
    assert task.controller.names[:7] == task.state_names[:7]
    assert still_of(task) == (*range(7), *[LAST] * (len(task.controller.names) - 7))


def test_the_arm_that_is_held_is_what_the_controller_holds():
    env = EnvSpec(task="PickCube").make(1, observation="state")
    try:
        env.reset(seed=0)
        state = env.get_states()
        held, seen = env.task.controller.hold(state)[0], env.task.proprioception(state)[0].numpy()
        np.testing.assert_allclose(held[:7], seen[list(still_of(env.task)[:7])], atol=1e-6)
    finally:
        env.close()


@pytest.mark.parametrize(
    ("name", "kwargs", "expected"),
    [
        ("PickCube", {"action_space": "hand"}, (*range(9), LAST)),
        (
            "libero/goal/turn_on_the_stove",
            {"action_space": "native", "observation_space": "native"},
            (ZERO,) * 7,
        ),
        ("calvin/D/open_drawer", {"action_space": "native"}, (*[ZERO] * 6, LAST)),
        ("control/franka_reach", {}, (LAST,) * 7),
        ("DrawerOpen", {}, (ZERO, ZERO, ZERO, LAST)),
        ("so101/open_drawer", {}, (*range(5), LAST)),
    ],
)
def test_holding_still_in_other_action_spaces(name, kwargs, expected):
    assert still_of(task_of(name, **kwargs)) == expected


def test_two_arms_hold_still_each_by_its_own_joints():
    task = task_of("TwoRobotPickCube")
    names, states = task.controller.names, task.state_names
    for name, source in zip(names, still_of(task), strict=True):
        assert source == LAST if "finger" in name else states[source] == name


def test_a_dataset_of_other_actions_and_an_unknown_task_are_errors(tasks, own):
    hand = replace(own, tasks=(learned(task_of("PickCube", action_space="hand")), *own.tasks[1:]))
    with pytest.raises(ConfigError, match=r"dataset's actions are x, y, z, .*, not joint1, .*task_kwargs"):
        with_wrong_instructions(hand, tasks)
    with pytest.raises(ConfigError, match="needs registered tasks, and the dataset has 'StackCube'"):
        with_wrong_instructions(own, {"PickCube": tasks["PickCube"]})


def test_a_task_that_cannot_be_held_still_is_refused_before_demonstrations_are_collected():
    words = ["policy=mtact", "task=control/ant", "policy.wrong_instructions=0.2"]
    with pytest.raises(ConfigError, match=r"how control/ant holds still.*wrong_instructions=0"):
        learner_of(compose("train", words), "cpu").check()


def test_a_run_without_wrong_instructions_keeps_its_name():
    config, asked = (
        compose("train", ["policy=mtact", "task=PickCube", *words])
        for words in ([], ["policy.wrong_instructions=0.2"])
    )
    assert "policy.wrong_instructions" not in identity(config)
    for zero in ("0", "0.0"):
        none = compose("train", ["policy=mtact", "task=PickCube", f"policy.wrong_instructions={zero}"])
        assert identity(none) == identity(config) and run_name(none) == run_name(config)
    assert identity(asked)["policy.wrong_instructions"] == 0.2
    assert run_name(config) != run_name(asked)
