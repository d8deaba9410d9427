"""Contracts of what solving a task means: success, reward, expert and random actions."""

from collections.abc import Sequence

import numpy as np
import torch

from envs.core.registry import plugins_word
from envs.joint_readings import joint_readings
from envs.scenario import RobotCfg
from roboverse_learn.checks.checked_task import CheckedTask
from roboverse_learn.checks.contract import NotApplicableError, contract, require

_FASTEST_RAD_S = 7.0
"""Fastest joint of an expert: 0.35 rad in a control step of 20 Hz."""

_LARGEST_DROP = 0.2
"""Reward that an expert may lose on its way: robosuite's drops while a nut is lowered on its peg."""

_SOLVED_BY_CHANCE = 0.5
"""Share of episodes that random actions may solve: an arm that beats about knocks a lid shut now and then."""


@contract("scene")
def unsolved_at_start(checked: CheckedTask) -> str:
    """No episode is solved, or has failed, before the first step."""
    env, count = checked.env, checked.episodes
    if not checked.task.ends_on_success:
        raise NotApplicableError("success does not end an episode")
    solved, failed = 0, 0
    for first in range(0, count, checked.num_envs):
        episodes = env.split_indices[first : min(first + checked.num_envs, count)]
        ids = np.arange(len(episodes))
        env.reset_envs(ids, episodes)
        state = env.get_states(ids)
        solved += int(checked.task.success(state).sum())
        failed += int(checked.task.failure(state).sum())
    require(
        not solved, f"{solved} of {count} starts are solved already. Let initial_state keep clear of success."
    )
    require(not failed, f"{failed} of {count} starts have failed already: check failure.")
    return f"0 of {count} starts"


@contract("scene")
def random_fails(checked: CheckedTask) -> str:
    """Random actions do not solve the task, and their rewards are finite and in range."""
    env, rng = checked.env, np.random.default_rng(1)
    checked.start()
    solved, over = np.zeros(checked.num_envs, bool), np.zeros(checked.num_envs, bool)
    steps = max(1, checked.task.max_episode_steps // 4)
    for _ in range(steps):
        step = env.step_envs(range(checked.num_envs), checked.random_actions(rng))
        _check_range(checked, np.asarray(step.reward)[~over], np.asarray(step.success)[~over])
        solved |= step.success & ~over
        over |= step.terminated | step.truncated
        if over.all():  # such as those of a robot that has fallen
            break
    require(
        solved.mean() <= _SOLVED_BY_CHANCE,
        f"Random actions solved {int(solved.sum())} of {len(solved)} episodes in {steps} steps. Ask more of "
        "success, or let the objects start farther from it.",
    )
    return f"{int(solved.sum())} of {len(solved)} episodes in {steps} steps"


def _check_range(checked: CheckedTask, rewards: np.ndarray, solved: np.ndarray) -> None:
    """Checks rewards of steps: 1 at success, and in [0, 1) elsewhere, where success ends an episode."""
    require(np.isfinite(rewards).all(), "The reward is not finite.")
    if not checked.task.ends_on_success:
        return
    outside = rewards[~solved & ((rewards < 0.0) | (rewards >= 1.0))]
    require(
        not len(outside),
        f"The reward of an unsolved state is {float(outside[0]) if len(outside) else 0:.3f}. It must be in "
        "[0, 1), so that 1 means success.",
    )


@contract("scene")
def expert_solves(checked: CheckedTask) -> str:
    """The expert solves most starts."""
    solved = sum(episode.success for episode in checked.rollouts)
    count = len(checked.rollouts)
    failed = [str(episode.position) for episode in checked.rollouts if not episode.success]
    seen = f"{solved} of {count} starts"
    require(
        solved >= checked.required * count,
        f"The expert solved {seen}, less than {100 * checked.required:g} %. Look at one that "
        f"failed ({', '.join(failed[:8])}): roboverse view task={checked.spec.task} split=test "
        f"episode={(failed or ['0'])[0]} {plugins_word()}".rstrip(),
    )
    return seen


@contract("expert_solves")
def expert_in_limits(checked: CheckedTask) -> str:
    """The limits of actions are finite, and the expert's actions are inside."""
    controller = checked.env.controller
    low, high = np.asarray(controller.low), np.asarray(controller.high)
    require(
        np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all(),
        "An action's limits are not finite, or its low is not below its high: check the joints' ranges.",
    )
    for episode in checked.rollouts:
        outside = ((episode.actions < low - 1e-4) | (episode.actions > high + 1e-4)).reshape(-1, len(low))
        names = [controller.names[column] for column in np.flatnonzero(outside.any(axis=0))]
        require(
            not names,
            f"The expert's actions leave the limits of {', '.join(names)}. Keep its waypoints within reach.",
        )
    return f"{len(low)} numbers, all within their limits"


@contract("expert_solves")
def expert_is_smooth(checked: CheckedTask) -> str:
    """Neither the arm's joints nor their targets jump: no joint is faster than 7 rad/s."""
    env = checked.env
    robots = checked.task.robots
    if not all(robot.fixed_base for robot in robots):
        raise NotApplicableError("the robot is no arm")
    joints = [(robot, name) for robot in robots for name in robot.joint_names]
    arm = [index for index, (robot, name) in enumerate(joints) if name not in robot.gripper_joints]
    limit, fastest = _FASTEST_RAD_S / env.control_hz, 0.0
    for episode in checked.rollouts:
        ways = [episode.observation_state[:, arm]]
        if env.controller.names == checked.task.reading_names:
            ways.append(_positions(robots, episode.actions)[:, arm])
        fastest = max(fastest, *(float(np.abs(np.diff(way, axis=0)).max(initial=0.0)) for way in ways))
    require(
        fastest < limit,
        f"A joint moves {fastest:.2f} rad in one control step, more than {limit:.2f}. Give the waypoints a "
        "longer duration_s, or keep them away from the edge of the robot's reach.",
    )
    return f"at most {fastest * env.control_hz:.1f} rad/s"


@contract("expert_solves")
def expert_varies(checked: CheckedTask) -> str:
    """The expert's episodes differ in length, as its starts and its way do."""
    lengths = [len(episode.actions) for episode in checked.rollouts]
    require(
        len(set(lengths)) > 1 or len(lengths) == 1,
        f"All {len(lengths)} episodes of the expert have {lengths[0]} steps. Vary its waypoints by the "
        "generator, and their duration by the way: policies learn to correct from what varies.",
    )
    return f"{min(lengths)} to {max(lengths)} steps"


@contract("expert_solves")
def reward_rises(checked: CheckedTask) -> str:
    """On the expert's way the reward rises to 1: what leads to success is worth more."""
    if not checked.task.ends_on_success:
        raise NotApplicableError("success does not end an episode")
    if not checked.task.has_reward:
        raise NotApplicableError(f"{checked.task.name} has no dense reward")
    worst = 0.0
    for episode in (each for each in checked.rollouts if each.success):
        rewards, name = episode.rewards, f"episode {episode.episode}"
        _check_range(checked, rewards, episode.successes)
        solved = int(np.argmax(rewards == 1.0))
        require(rewards[solved] == 1.0, f"The reward never is 1 in the solved {name}: check success.")
        way = rewards[: solved + 1]
        worst = max(worst, float((np.maximum.accumulate(way) - way).max()))
        quarter = max(1, len(way) // 4)
        require(
            way[:quarter].mean() < way[-quarter:].mean(),
            f"In {name} the last quarter of the way to success is worth no more than the first: reward what "
            "comes nearer to success.",
        )
        require(solved < 1 or way[0] < way[solved - 1], f"In {name} the reward before success is its first.")
    require(
        worst < _LARGEST_DROP,
        f"The reward drops by {worst:.2f} on the expert's way, {_LARGEST_DROP} or more: the expert's way is "
        "no way up. Reward each part of the way as much as the next one begins with.",
    )
    return f"drops by at most {worst:.2f}"


@contract("scene")
def touches_nothing(checked: CheckedTask) -> str:
    """Success, failure, reward and observation change no state, and answer alike twice."""
    checked.start()
    state, task = checked.env.get_states(), checked.task
    kept = {key: value.clone() for key, value in state.flatten().items()}
    for name in ("success", "failure", "reward", "observe"):
        answer = getattr(task, name)
        first, second = answer(state), answer(state)
        require(
            torch.equal(first, second), f"{name} gave two answers for one state. Make it a pure function."
        )
        changed = [key for key, value in state.flatten().items() if not torch.equal(value, kept[key])]
        require(not changed, f"{name} changed {', '.join(changed)} of the state. Copy before you write.")
    return "pure functions"


def _positions(robots: Sequence[RobotCfg], actions: np.ndarray) -> np.ndarray:
    """Returns targets (T, J), rad (m), of actions (T, J) of all joints of the robots."""
    ends = np.cumsum([len(robot.joints) for robot in robots])[:-1]
    parts = np.split(actions, ends, axis=1)
    read = [joint_readings(robot).positions(part) for robot, part in zip(robots, parts, strict=True)]
    return np.concatenate(read, axis=1)
