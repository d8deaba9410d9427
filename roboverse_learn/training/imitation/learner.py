"""Imitation learning of a run: from its dataset to a trained policy."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, override

import policies
from envs.core.errors import ConfigError, UnknownNameError, unknown_name
from envs.core.observation_keys import IMAGE_PREFIX
from policies.base import listed
from policies.checkpoint import policy_type, resolve
from roboverse_learn.commands.collected import of_task
from roboverse_learn.training.imitation.estimate import estimate_training_s, plain_stats
from roboverse_learn.training.imitation.wordings import with_bank_wordings
from roboverse_learn.training.imitation.wrong_instructions import still_of, with_wrong_instructions
from roboverse_learn.training.learners import Demonstrations, Learner
from roboverse_learn.training.reporter import Reporter, TrainResult

if TYPE_CHECKING:
    from envs.tasks.base import Task
    from roboverse_learn.data.dataset.mixture import Mixture
    from roboverse_learn.data.dataset.reader import ResidentDataset
    from roboverse_learn.data.dataset.schema import Feature


class ImitationLearner(Learner):
    """Trains a policy on demonstrations; see :func:`roboverse_learn.training.imitation.train.train`."""

    @override
    def check(self) -> None:
        """See :meth:`Learner.check`.

        Raises:
            ConfigError: if there are no demonstrations of one of several tasks, they cannot be collected,
                their images, or what the policy cannot pad, differ, or a batch is too small for them.
            PolicyError: if the policy takes no setting of training that is given.
        """
        from roboverse_learn.commands.dataset_layout import dataset_layout

        config = self.config
        if check := getattr(config.policy, "check_training", None):
            check(config.train)
        if config.train.resume_from:
            self._check_beginning()
        if self._asks_wrongly:
            for task in self._tasks().values():
                still_of(task)
        if len(config.tasks) > 1:
            self._check_several()
        features = dataset_layout(config)[0]
        self._check_swap(features)
        if check := policies.check_of(config.policy_name):
            check(config.policy, features)
        self._check_shares()  # last, for it may import the policy

    def _check_swap(self, features: "Mapping[str, Feature]") -> None:
        """Checks that the camera whose images are to be swapped is seen."""
        augment = self.config.train.augment
        cameras = [key.removeprefix(IMAGE_PREFIX) for key in features if key.startswith(IMAGE_PREFIX)]
        if augment.swap and augment.swap_camera not in cameras:
            raise unknown_name("camera of train.augment.swap_camera", augment.swap_camera, cameras)

    def _check_several(self) -> None:
        """Checks that several tasks can be learned together."""
        config = self.config
        if config.source != "expert":
            raise ConfigError(
                f"source={config.source} gives demonstrations of one task, and task={listed(config.tasks)} "
                "are several. Collect each, join them with roboverse dataset merge, and give dataset=."
            )
        if config.dataset:
            self._check_demonstrated()
        else:
            tasks = self._tasks()
            self._check_images(tasks)
            self._check_widths(tasks)

    def _check_shares(self) -> None:
        """Checks that a batch has frames of each task, as far as it is known before they are collected."""
        from roboverse_learn.data.dataset.sampler import shares_of_a_batch

        train, (frames, guessed) = self.config.train, self._frames_of_tasks()
        if len(frames) > 1:
            processes = int(os.environ.get("WORLD_SIZE", "1"))
            given = list(frames.values()), train.batch_size, train.mixing, processes
            shares_of_a_batch(*given, guessed=guessed)
        elif train.mixing:
            raise ConfigError(
                f"train.mixing={train.mixing:g} weighs several tasks, and the run is of "
                f"{next(iter(frames), self.config.env.task)} alone. Leave it out, or name several, as in "
                "policy=mtact task=[PickCube,StackCube]."
            )

    def _frames_of_tasks(self) -> tuple[dict[str, int], bool]:
        """Returns the frames of each task that is learned, and whether they are guessed.

        They are where none are there yet: as if all tasks had as many.
        """
        from roboverse_learn.data.dataset.info import DatasetInfo
        from roboverse_learn.data.dataset.mixture import frames_of_tasks

        config = self.config
        if config.dataset and policies.learns_several(config.policy_name):
            return frames_of_tasks(DatasetInfo.open(config.dataset), config.env.task), False
        return dict.fromkeys(config.tasks, 1), True

    def _check_beginning(self) -> None:
        """Checks that the checkpoint to begin with is there and of this policy."""
        given, name = self.config.train.resume_from, self.config.policy_name
        found = policy_type(resolve(given))
        if found != name:
            raise ConfigError(
                f"train.resume_from={given} is of policy '{found}', and the run trains '{name}'. "
                f"Give policy={found}, or leave it out."
            )

    @property
    def _asks_wrongly(self) -> bool:
        return bool(getattr(self.config.policy, "wrong_instructions", 0.0))

    def _tasks(self) -> "dict[str, Task]":
        return {name: of_task(self.config, name).env.make_task() for name in self.config.tasks}

    def _check_images(self, tasks: "Mapping[str, Task]") -> None:
        """Checks that the cameras of a run are those of each of its tasks, with images of one size."""
        env, sizes = self.config.env, {}
        for name, task in tasks.items():
            try:
                seen = task.scenario.seen_by(env.cameras, env.image_size).cameras
            except UnknownNameError as error:
                present = ", ".join(camera.name for camera in task.scenario.cameras)
                raise ConfigError(
                    f"cameras={listed(env.cameras)} must be cameras of every task that is learned, and "
                    f"{name} has {present}. {_shared_cameras(tasks)}"
                ) from error
            sizes[name] = ", ".join(f"{camera.name} of {camera.width} × {camera.height}" for camera in seen)
        first, other = _first_and_unlike(sizes)
        if other is not None:
            raise ConfigError(
                f"{first} and {other} cannot be learned together: one has the images {sizes[first]}, the "
                f"other {sizes[other]}. Give cameras that both have, or learn tasks of one suite together."
            )

    def _check_widths(self, tasks: "Mapping[str, Task]") -> None:
        """Checks that tasks have states and actions of one width, for a policy that pads none."""
        if getattr(type(self.config.policy), "pads_tasks", False):
            return
        widths = {
            name: f"{len(task.state_names)} numbers of state and {len(task.controller.names)} of action"
            for name, task in tasks.items()
        }
        first, other = _first_and_unlike(widths)
        if other is not None:
            raise ConfigError(
                f"policy={self.config.policy_name} learns tasks of one width together, and {first} has "
                f"{widths[first]}, {other} {widths[other]}. Take tasks of one robot, or policy=mtact, which "
                "pads."
            )

    def _check_demonstrated(self) -> None:
        """Checks that a given dataset names all tasks of the run."""
        from roboverse_learn.data.dataset.info import DatasetInfo

        named = DatasetInfo.open(self.config.dataset).named_tasks
        missing = [task for task in self.config.tasks if task not in named]
        if missing:
            there = f"demonstrations of {', '.join(named)} alone" if named else "episodes that name no task"
            raise ConfigError(
                f"dataset={self.config.dataset} has {there}, and the run is of "
                f"{', '.join(self.config.tasks)}. Leave out dataset= to collect each task, "
                "or name the tasks that it has."
            )

    @override
    def too_few_steps(self) -> str:
        config = self.config.train
        if config.steps > config.warmup_steps:
            return ""
        return (
            f"train.steps={config.steps} are all warm-up (train.warmup_steps={config.warmup_steps}): "
            "training ends while the learning rate still rises to its peak, and the policy learns little. "
            "Give more steps, or a shorter warm-up."
        )

    @override
    def estimate_s(self) -> float:
        from roboverse_learn.commands.dataset_layout import dataset_layout

        config = self.config
        features, _, _ = dataset_layout(config)
        policy = policies.create(
            config.policy_name, features, plain_stats(features), config.policy, self.device
        )
        return estimate_training_s(policy, config.train)

    @override
    def learn(
        self, run_dir: Path, dataset: Demonstrations | None, seed: int, reporter: Reporter
    ) -> TrainResult:
        from roboverse_learn.training.imitation.train import train

        assert dataset is not None
        name = self.config.policy_name
        data = self._open(dataset)
        policy = policies.create(
            name, data.info.features, data.info.stats, self.config.policy, self.device, seed=seed
        )
        if self.config.train.resume_from:
            policy.begin_with(self.config.train.resume_from)
        instructions: Any = getattr(data, "instructions", None)
        if instructions is not None:
            if getattr(self.config.policy, "bank_wordings", False):
                instructions = with_bank_wordings(instructions)
            if self._asks_wrongly:
                instructions = with_wrong_instructions(instructions, self._tasks())
            policy.learn_instructions(instructions)
        settings = policy.training_config(self.config.train)
        return train(policy, data, settings, run_dir, seed=seed, reporter=reporter)

    def _open(self, dataset: Demonstrations) -> "ResidentDataset | Mixture":
        """Reads demonstrations: of a policy that reads instructions, by their tasks."""
        from roboverse_learn.data.dataset.mixture import Mixture
        from roboverse_learn.data.dataset.reader import ResidentDataset

        folders = dataset if isinstance(dataset, Mapping) else {self.config.env.task: dataset}
        if policies.learns_several(self.config.policy_name):
            return Mixture.open(folders, self.device)
        (folder,) = folders.values()
        return ResidentDataset(folder, device=self.device)


def _shared_cameras(tasks: "Mapping[str, Task]") -> str:
    """Says which cameras to name: those that all tasks have."""
    first, *others = ([camera.name for camera in task.scenario.cameras] for task in tasks.values())
    if shared := [name for name in first if all(name in each for each in others)]:
        return f"Name those that all have, as in cameras={listed(shared)}."
    return "The tasks have no camera in common: learn tasks of one suite together."


def _first_and_unlike(of_tasks: "Mapping[str, str]") -> tuple[str, str | None]:
    """Returns the first task, and the first one of which something else is so; None where all are alike."""
    first = next(iter(of_tasks))
    return first, next((name for name in of_tasks if of_tasks[name] != of_tasks[first]), None)
