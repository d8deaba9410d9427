"""The tasks that a checkpoint was trained on, as far as it, or its run, says so."""

from pathlib import Path

from envs.core.errors import PolicyError
from roboverse_learn.config.schema import TrainRunConfig


def known_tasks(checkpoint: Path) -> tuple[str, ...]:
    """Returns the tasks that a checkpoint was trained on; none where nothing is known of them.

    LeRobot's checkpoints do not name them; then they are those of the run and of the dataset that it was
    given. Where that is of another program, whose episodes name no task, the run's one task is only where it
    is to be evaluated.

    Args:
        checkpoint: A pretrained folder, or that of its run.
    """
    from policies.checkpoint import learned_tasks, resolve
    from roboverse_learn.commands.run_folder import read_config, run_of

    if learned := learned_tasks(checkpoint):
        return learned
    try:
        folder = run_of(resolve(checkpoint))
    except PolicyError:  # a name on the hub, or nothing, which opening it says
        return ()
    return () if folder is None else _tasks_of_run(folder, read_config(folder))


def learned_together(checkpoint: Path) -> tuple[str, ...]:
    """Returns the tasks that a checkpoint was trained on together; none where it was one."""
    learned = known_tasks(checkpoint)
    return learned if len(learned) > 1 else ()


def _tasks_of_run(folder: Path, trained: TrainRunConfig) -> tuple[str, ...]:
    from roboverse_learn.commands.run_folder import read_facts

    if not trained.dataset:
        return trained.tasks
    named = read_facts(folder, "collect").get("tasks")
    if named == [] and len(trained.tasks) == 1:
        return ()
    return tuple(dict.fromkeys([*trained.tasks, *(named or ())]))  # older runs do not record the dataset's
