"""The contracts of a task, in the order in which they are looked at."""

from roboverse_learn.checks import task_data, task_episodes, task_solving
from roboverse_learn.checks.checked_task import CheckedTask
from roboverse_learn.checks.contract import Contract

TASK_CONTRACTS: tuple[Contract[CheckedTask], ...] = (
    task_data.options,
    task_data.words,
    task_data.scenario,
    task_data.initial_states,
    task_episodes.scene,
    task_episodes.images,
    task_episodes.spaces,
    task_episodes.deterministic,
    task_episodes.any_num_envs,
    task_episodes.set_and_get,
    task_episodes.own_memory,
    task_episodes.starts_vary,
    task_episodes.at_rest,
    task_data.not_finite,
    task_solving.touches_nothing,
    task_solving.unsolved_at_start,
    task_solving.random_fails,
    task_solving.expert_solves,
    task_solving.expert_in_limits,
    task_solving.expert_is_smooth,
    task_solving.expert_varies,
    task_solving.reward_rises,
)
