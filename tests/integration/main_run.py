"""The main command as small as it gets, and where it leaves its parts."""

from dataclasses import dataclass
from pathlib import Path

from roboverse_learn.commands.run_folder import read_facts

TINY = (
    *("policy=act", "task=PickCube", "preset=quick", "image_size=32", "device=cpu", "slow_ok=true"),
    *("cameras=[front]", "num_demos=4", "collect.num_workers=1", "collect.num_envs=2"),
    *("train.steps=12", "batch_size=2", "save_every=4", "log_every=1"),
    *("train.num_threads=1", "policy.dim_model=32", "policy.dim_feedforward=32", "policy.n_heads=2"),
    *("policy.chunk_size=50", "policy.n_action_steps=50"),
    *("levels=[0,3]", "splits=[test]", "episodes=1", "evaluate.num_envs=1"),
)


@dataclass(frozen=True)
class MainRun:
    """What ``roboverse train`` left behind.

    Attributes:
        folder: Where it was started.
        run: The run's folder.
        dataset: The dataset's folder.
        checkpoint: The last checkpoint.
        result: The results file.
    """

    folder: Path
    run: Path
    dataset: Path
    checkpoint: Path
    result: Path

    @classmethod
    def at(cls, folder: Path) -> "MainRun":
        """Finds the parts of the one run below a folder."""
        (run,) = (folder / "runs/PickCube/act").iterdir()
        return cls(
            folder=folder,
            run=run,
            dataset=folder / read_facts(run, "collect")["folder"],
            checkpoint=run / "checkpoints/last/pretrained_model",
            result=folder / "results/v2/PickCube/act" / f"{run.name}.json",
        )
