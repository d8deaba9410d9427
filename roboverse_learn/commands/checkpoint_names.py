"""Names of checkpoints in results: of their runs, or of their folders."""

from pathlib import Path

from roboverse_learn.commands.scene_labels import fit_for_a_file


def checkpoint_name(given: str, checkpoint: Path) -> str:
    """Returns a short name of a checkpoint: of its run, or as :func:`name_without_run` has it."""
    from roboverse_learn.commands.run_folder import result_name, run_of

    folder = run_of(checkpoint)
    return name_without_run(given, checkpoint) if folder is None else result_name(folder)


def name_without_run(given: str, checkpoint: Path) -> str:
    """Returns a name, fit for a file, of a checkpoint of no run: of its folder, or that on the hub.

    Args:
        given: What the command was given.
        checkpoint: The pretrained folder.
    """
    name = checkpoint.absolute().parent.name if Path(given).exists() else given
    return fit_for_a_file(name).rstrip("-.").lstrip("._+=-") or "checkpoint"
