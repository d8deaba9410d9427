"""Contracts of a task's environment: scene, spaces, determinism, observations."""

import warnings

import numpy as np
import torch

from envs.gym_env import RoboVerseEnv
from envs.state import State
from roboverse_learn.checks.checked_task import CheckedTask
from roboverse_learn.checks.contract import (
    BrokenContractError,
    NotApplicableError,
    contract,
    counted,
    require,
)

_STEPS = 5
_NUM_STARTS = 30
_DERIVED = ("ee_pos", "ee_rot", "touched")
"""Parts of a state that a simulator computes and does not take."""

_HOLD_S, _REST_M = 10.0, 2e-3


@contract("scenario")
def scene(checked: CheckedTask) -> str:
    """The simulator makes the scene, and the task judges its states."""
    env = checked.env
    checked.start()
    state, rows = env.get_states(), checked.num_envs
    for name, answer, kind in (
        ("success", checked.task.success(state), torch.bool),
        ("failure", checked.task.failure(state), torch.bool),
        ("reward", checked.task.reward(state), None),
    ):
        shape, dtype = tuple(answer.shape), answer.dtype
        require(
            shape == (rows,), f"{name} returned the shape {shape} for {rows} states; it must be ({rows},)."
        )
        require(kind in (None, dtype), f"{name} returned {dtype}; it must be {kind}.")
    seen = checked.task.observe(state)
    require(
        seen.ndim == 2 and len(seen) == rows,
        f"observe returned the shape {tuple(seen.shape)} for {rows} states; it must be ({rows}, D).",
    )
    robots = " and ".join(robot.name for robot in env.scenario.robots)
    return f"{robots} in {env.simulator}, {env.control_hz:g} Hz"


@contract("scene")
def images(checked: CheckedTask) -> str:
    """Every camera sees something: no image is of one colour."""
    checked.start()
    rendered = checked.env.handler.render(None, ("rgb",), [0])
    if not rendered:
        raise NotApplicableError("the scenario has no camera")
    for camera, kinds in rendered.items():
        require(
            np.asarray(kinds["rgb"]).std(axis=(1, 2)).max() > 1.0,
            f"The image of the camera '{camera}' has one colour. Check its pos and look_at, and the lights.",
        )
    return ", ".join(rendered)


@contract("scene")
def spaces(checked: CheckedTask) -> str:
    """Gymnasium's check_env accepts the environment: observations are in their space."""
    from gymnasium.utils.env_checker import check_env

    spec = {key: value for key, value in checked.spec.to_json().items() if key != "task"}
    single = RoboVerseEnv(checked.spec.task, observation="state", **spec)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*symmetric and normalized space")
            check_env(single, skip_render_check=True)
    except AssertionError as error:
        raise BrokenContractError(f"Gymnasium's check_env: {' '.join(str(error).split())}") from error
    finally:
        single.close()
    size = checked.observed_starts(1).shape[1]
    return f"observation {size}, action {len(checked.env.controller.names)}"


@contract("scene")
def deterministic(checked: CheckedTask) -> str:
    """Equal seeds and actions give bit-identical observations."""
    env = checked.env

    def observations() -> list[dict[str, np.ndarray]]:
        first, _ = env.reset(seed=[5 + row for row in range(checked.num_envs)])
        rng = np.random.default_rng(0)
        return [first, *(env.step(checked.random_actions(rng))[0] for _ in range(_STEPS))]

    for step, (first, second) in enumerate(zip(observations(), observations(), strict=True)):
        for key in first:
            require(
                np.array_equal(first[key], second[key]),
                f"{key} differs after {step} steps of the same seed and actions. Keep nothing between "
                "episodes, and draw from the given generators alone.",
            )
    return f"{_STEPS} steps, bit-identical"


@contract("scene")
def any_num_envs(checked: CheckedTask) -> str:
    """An episode is the same alone as beside others."""
    env, row = checked.env, checked.num_envs - 1
    checked.start()
    rng = np.random.default_rng(0)
    actions = [checked.random_actions(rng) for _ in range(_STEPS)]
    for chunk in actions:
        env.step_envs(range(checked.num_envs), chunk)
    beside = env.get_states([row])
    alone = checked.make(1)
    try:
        alone.reset_envs([0], env.split_indices[row : row + 1])
        for chunk in actions:
            alone.step_envs([0], chunk[row : row + 1])
        found = _differing(alone.get_states([0]), beside, exact=beside.device.type == "cpu")
    finally:
        alone.close()
    require(
        not found,
        f"{found} differs after {_STEPS} steps between one environment and {checked.num_envs}. Compute every "
        "row of a batch from that row alone.",
    )
    return f"1 and {checked.num_envs} environments"


@contract("scene")
def set_and_get(checked: CheckedTask) -> str:
    """A state that was read can be set again, and is the same when it is read back."""
    env, rng = checked.env, np.random.default_rng(0)
    checked.start()
    for _ in range(_STEPS):
        env.step_envs(range(checked.num_envs), checked.random_actions(rng))
    state = env.get_states()
    env.step_envs(range(checked.num_envs), checked.random_actions(rng))
    env.handler.set_states(state)
    found = _differing(env.get_states(), state, but=_DERIVED)
    require(not found, f"{found} is another one after it was set: the simulator cannot restore this scene.")
    return "bit-identical"


def _differing(state: State, expected: State, *, but: tuple[str, ...] = (), exact: bool = True) -> str:
    """Returns the first part of a state that differs from the expected one, or nothing."""
    flat = state.flatten()
    for key, value in expected.flatten().items():
        if key.rpartition("/")[2] in but:
            continue
        same = torch.equal(flat[key], value) if exact else torch.allclose(flat[key], value, atol=1e-3)
        if not same:
            return key
    return ""


@contract("scene")
def own_memory(checked: CheckedTask) -> str:
    """Observations are finite, and stay what they were while the environment steps."""
    env = checked.env
    env.reset(seed=0)
    first = env.observe()
    copies = {key: value.copy() for key, value in first.items()}
    env.step(checked.random_actions(np.random.default_rng(0)))
    require(set(first.pop("task")) <= set(env.task.instructions), "An episode has a foreign instruction.")
    for key, value in first.items():
        require(np.isfinite(value).all(), f"{key} is not finite.")
        require(
            np.array_equal(value, copies[key]),
            f"{key} changed after it was returned: observe must return new tensors, not views of a state.",
        )
    return counted(len(first), "key")


@contract("scene")
def starts_vary(checked: CheckedTask) -> str:
    """Every episode starts otherwise, and the observation shows it."""
    values = checked.observed_starts(_NUM_STARTS)
    moving = values.std(axis=0) > 1e-6
    require(
        moving.any(),
        f"observe returned the same numbers at {len(values)} starts. Draw poses in initial_state from the "
        "generators, and let observe return them.",
    )
    distinct = len(np.unique(values, axis=0))
    require(
        distinct == len(values),
        f"{len(values)} starts have only {distinct} observations. Draw continuous numbers, and observe them.",
    )
    return f"{int(moving.sum())} of {len(moving)} entries vary over {len(values)} starts"


@contract("scene")
def at_rest(checked: CheckedTask) -> str:
    """Objects keep still for 10 s while the robot holds its posture: no sliding, sinking or flying."""
    env = checked.env
    if not env.scenario.robots[0].fixed_base:
        raise NotApplicableError("a robot that falls may move things")
    checked.start()
    before = env.get_states()
    hold = env.controller.hold(before)
    for _ in range(round(_HOLD_S * env.control_hz)):
        env.step_envs(range(checked.num_envs), hold)
    after = env.get_states()
    for name, entity in before.objects.items():
        moved = float(torch.linalg.vector_norm(after.objects[name].pos - entity.pos, dim=-1).max())
        require(
            moved < _REST_M,
            f"'{name}' moved {1000 * moved:.0f} mm while the robot held still for {_HOLD_S:g} s. Let it "
            "start at rest on what carries it: half its height above the table, clear of the robot.",
        )
    return counted(len(before.objects), "object")
