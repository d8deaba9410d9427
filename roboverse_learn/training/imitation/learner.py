"""Imitation learning of a run: from its dataset to a trained policy."""

from pathlib import Path
from typing import override

import policies
from roboverse_learn.training.imitation.estimate import estimate_training_s, plain_stats
from roboverse_learn.training.learners import Learner
from roboverse_learn.training.reporter import Reporter, TrainResult


class ImitationLearner(Learner):
    """Trains a policy on demonstrations; see :func:`roboverse_learn.training.imitation.train.train`."""

    @override
    def check(self) -> None:
        from policies.zoo import preflight
        from roboverse_learn.collect import dataset_layout

        checks = {"lerobot": preflight.check_lerobot, "openvla": preflight.check_openvla}
        if check := checks.get(self.config.policy_name):
            check(self.config.policy, dataset_layout(self.config)[0])

    @override
    def estimate_s(self) -> float:
        from roboverse_learn.collect import dataset_layout

        config = self.config
        features, _, _ = dataset_layout(config)
        policy = policies.create(
            config.policy_name, features, plain_stats(features), config.policy, self.device
        )
        return estimate_training_s(policy, config.train)

    @override
    def learn(self, run_dir: Path, dataset: str | None, seed: int, reporter: Reporter) -> TrainResult:
        from roboverse_learn.data.dataset.reader import ResidentDataset
        from roboverse_learn.training.imitation.train import train

        assert dataset is not None
        data = ResidentDataset(dataset, device=self.device)
        policy = policies.create(
            self.config.policy_name,
            data.info.features,
            data.info.stats,
            self.config.policy,
            self.device,
            seed=seed,
        )
        policy.instructions = data.info.tasks
        settings = policy.training_config(self.config.train)
        return train(policy, data, settings, run_dir, seed=seed, reporter=reporter)
