"""Trains the policy of a run on the dataset that its words name: ``roboverse train`` without evaluation."""

import sys
from pathlib import Path

from envs.core.errors import RoboVerseError

FAILED = "Training failed: "
"""How the line begins that says why, among those of the launcher."""


def main(words: list[str]) -> None:
    """Trains; ``dataset=`` and ``run=`` must be among the words."""
    from roboverse_learn.config.compose import compose
    from roboverse_learn.training.device import resolve_device
    from roboverse_learn.training.learners import learner_of
    from roboverse_learn.training.reporter import Reporter

    try:
        config = compose("train", words)
        assert config.run and config.dataset
        learner = learner_of(config, resolve_device(config.device))
        learner.learn(Path(config.run), str(config.dataset), config.seed, Reporter())
    except RoboVerseError as error:
        sys.exit(f"{FAILED}{error}")


if __name__ == "__main__":
    main(sys.argv[1:])
