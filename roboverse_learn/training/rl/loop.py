"""Training loop of agents that act in many environments at once and learn from a replay buffer.

An :class:`Algorithm` acts, stores and learns; the loop has no loss and no network. On a CPU a killed run
resumes bit-identically: every checkpoint reseeds the noise, and sets the env to its saved state if it has
a ``state_dict``; if not, its episodes restart.
A checkpoint out of turn, where a run ends early, keeps where the random numbers were instead. It may
come between two updates of a step: those that are left are due still, and made first.
"""

import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor

from roboverse_learn.training import checkpoint
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.device import cpu_threads
from roboverse_learn.training.divergence import TrainingDivergedError
from roboverse_learn.training.interruption import Interruption, signals_noted
from roboverse_learn.training.metrics import MetricsWriter, open_writers, plot_training
from roboverse_learn.training.randomness import random_state, set_random_state, step_seed
from roboverse_learn.training.reporter import Progress, Reporter, TrainResult, seconds_left

logger = logging.getLogger(__name__)

OBSERVATION = "observation.environment_state"
"""The key that holds the whole observation when the policy is evaluated."""

_NOISE, _ENV = 0, 1


class Algorithm(Protocol):
    """Interface of a learning algorithm.

    Attributes:
        policy: What it trains.
        batch_size: Samples of an update.
        settings: Whatever else must be the same to resume a run.
    """

    policy: Any
    batch_size: int
    settings: dict[str, Any]

    def act(self, observation: Tensor, first: Tensor) -> Tensor:
        """Chooses actions (N, A) with noise to explore; ``first`` (N,): an episode has just begun."""
        ...

    def store(self, observation: Tensor, action: Tensor, step: Any) -> None:
        """Stores the step that followed the actions; ``step`` is an :class:`~envs.torch_env.EnvStep`."""
        ...

    def must_learn(self) -> bool:
        """Whether an update is due; it is made before the next step, or by the resumed run."""
        ...

    def learn(self) -> Mapping[str, Tensor]:
        """Makes one of the updates that are due; returns its terms, on the device."""
        ...

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Returns the state that resuming needs, the policy included, as tensors and plain JSON."""
        ...

    def load(self, tensors: Mapping[str, Tensor], numbers: Mapping[str, Any]) -> None:
        """Takes back what :meth:`state` returned."""
        ...

    def set_progress(self, fraction: float) -> None:
        """Hears how much of the run is done, for schedules."""
        ...

    def may_stop(self) -> bool:
        """Whether :meth:`state` loses nothing now; a rollout that is under way is not saved."""
        ...


def run(
    algorithm: Algorithm,
    env: Any,
    config: TrainConfig,
    run_dir: str | Path,
    *,
    seed: int = 0,
    reporter: Reporter | None = None,
    resume: bool = True,
    stagger: bool = False,
) -> TrainResult:
    """Trains until ``config.steps`` environment steps or ``config.time_limit_s`` seconds are over.

    Args:
        algorithm: What learns; trained in place.
        env: A :class:`~envs.torch_env.TorchVectorEnv`, or what has its interface.
        config: How long to train, and how often to log and save; both count environment steps.
        run_dir: Where checkpoints, metrics and plots go.
        seed: Root of all randomness.
        reporter: Hears of the progress.
        resume: Resume from the last checkpoint of ``run_dir``, if there is one.
        stagger: Let the first episodes end at different times, if the env can (``stagger``). Without it
            every rollout that is shorter than an episode sees one part of the episodes alone.

    Raises:
        CheckpointError: if the checkpoint to resume from is damaged or of another configuration, or if a
            new one cannot be written.
        Interrupted: after a checkpoint, on SIGINT or SIGTERM.
        TrainingDivergedError: if a term of the loss or a weight becomes infinite or NaN.
    """
    device = algorithm.policy.device
    devices = [torch.cuda.current_device()] if device.type == "cuda" else []
    precision = torch.get_float32_matmul_precision()
    with cpu_threads(config.num_threads, device.type), torch.random.fork_rng(devices=devices):
        torch.set_float32_matmul_precision("high" if devices else precision)
        try:
            loop = Loop(algorithm, env, config, Path(run_dir), seed, reporter or Reporter())
            loop.stagger = stagger and hasattr(env, "stagger")
            return loop.run(resume)
        finally:
            torch.set_float32_matmul_precision(precision)


class Loop:
    """One run of :func:`run`; :meth:`begin` and :meth:`advance` alone write nothing."""

    def __init__(
        self,
        algorithm: Algorithm,
        env: Any,
        config: TrainConfig,
        run_dir: Path,
        seed: int,
        reporter: Reporter,
    ) -> None:
        self.algorithm, self.env, self.config = algorithm, env, config
        self.run_dir, self.seed, self.reporter = run_dir, seed, reporter
        policy, own = algorithm.policy, algorithm.settings
        self.settings = {
            "policy": policy.name, "seed": seed, "num_envs": env.num_envs, "task": policy.task, **own,
        }  # fmt: skip
        self.step, self.first_step, self.elapsed_before = 0, 0, 0.0
        self.updates, self.first_update = 0, 0
        self.sums: dict[str, Tensor] = {}
        self.pending, self.logged_at = 0, -1
        self.stagger = False
        self.episodes: Any = None
        self.means: dict[str, float] = {}
        self.observation, self.first = torch.empty(0), torch.empty(0)
        self.start = time.perf_counter()

    def run(self, resume: bool) -> TrainResult:
        """Trains to the end."""
        checkpoint.remove_leftovers(self.run_dir)
        directory = checkpoint.last_checkpoint(self.run_dir) if resume else None
        self.run_dir.mkdir(parents=True, exist_ok=True)
        self.begin(directory)
        writers = open_writers(self.run_dir, self.step, self.config, self.algorithm.policy.name)
        self.start = time.perf_counter()
        saved_at = (self.step, self.updates) if directory is not None else None
        with signals_noted() as interruption:
            try:
                self.reporter.on_start(self._progress(), self.algorithm.policy)
                while not self._is_done() and not self._is_to_stop(interruption):
                    if not self.algorithm.must_learn():
                        self._act()
                    if self.algorithm.must_learn():
                        self._learn()
                    if self._crossed(self.config.log_every) or self._is_done():
                        self._log(writers)
                    self.reporter.on_step(self._progress())
                    if self._crossed(self.config.save_every):
                        self._log(writers)
                        self._save(in_turn=True)
                        saved_at = (self.step, self.updates)
                if saved_at != (self.step, self.updates):
                    self._log(writers)
                    self._save(in_turn=False)
            finally:
                for writer in writers:
                    writer.close()
        return self._finish()

    def advance(self) -> None:
        """One step of every environment, and the updates that it makes due."""
        self._act()
        while self.algorithm.must_learn():
            self._learn()

    def _act(self) -> None:
        self.algorithm.set_progress(self._fraction())
        action = self.algorithm.act(self.observation, self.first)
        step = self.env.step(action)
        self._check_terms()
        self.algorithm.store(self.observation, action, step)
        self.observation, self.first = step.obs, step.terminated | step.truncated
        self.step += self.env.num_envs

    def _learn(self) -> None:
        try:
            terms = self.algorithm.learn()
        except TrainingDivergedError as error:
            raise TrainingDivergedError(f"{error} {checkpoint.what_is_kept(self.run_dir)}") from error
        for key, value in terms.items():
            self.sums[key] = self.sums[key] + value if key in self.sums else value.clone()
        self.pending += 1
        self.updates += 1

    def begin(self, directory: Path | None) -> None:
        """Starts, or resumes from a checkpoint."""
        if directory is None:
            self._seed()
            self._restart_env()
            return
        state = checkpoint.load_checkpoint(directory, self.settings)
        numbers = state.numbers
        self.algorithm.load(checkpoint.part(state.tensors, "algorithm"), numbers["algorithm"])
        self.step = self.first_step = state.step
        self.updates = self.first_update = numbers["updates"]
        self.elapsed_before = state.elapsed_s
        self._seed()
        self._put_env(checkpoint.part(state.tensors, "env"), state.tensors["first"])
        set_random_state(checkpoint.part(state.tensors, "random"), self.env)
        logger.info("Resuming from step %d of '%s'.", self.step, directory)

    def _seed(self) -> None:
        """Seeds all random numbers from here on by the seed of the run and the step."""
        torch.manual_seed(step_seed(self.seed, self.step, _NOISE))
        self.env.seed(step_seed(self.seed, self.step, _ENV))

    def _put_env(self, tensors: Mapping[str, Tensor], first: Tensor) -> None:
        if tensors:
            self.observation = self.env.load_state_dict(tensors)
            self.first = first.to(self.observation.device)
        else:
            self._restart_env()

    def _restart_env(self) -> None:
        """Resets every environment; staggering follows, since a reset undoes it."""
        self.observation = self.env.reset()
        self.first = torch.ones(self.env.num_envs, dtype=torch.bool, device=self.observation.device)
        if self.stagger:
            self.env.stagger()

    def _save(self, *, in_turn: bool) -> None:
        """Writes a checkpoint and continues from its exact state; out of turn, as if there were none."""
        if key := checkpoint.not_finite(self.algorithm.policy.state_dict()):
            raise self._diverged(f"The weight '{key}' is not finite")
        random = {} if in_turn else random_state(self.env)
        of_env: Mapping[str, Tensor] = self.env.state_dict() if hasattr(self.env, "state_dict") else {}
        tensors, numbers = self.algorithm.state()
        state = checkpoint.TrainState(
            step=self.step,
            elapsed_s=self._elapsed(),
            settings=self.settings,
            numbers={"algorithm": numbers, "updates": self.updates},
            tensors=checkpoint.named(tensors, "algorithm")
            | checkpoint.named(of_env, "env")
            | checkpoint.named(random, "random")
            | {"first": self.first},
        )
        directory = checkpoint.save_checkpoint(self.run_dir, self.algorithm.policy, state)
        if in_turn:
            self._seed()
            if of_env:
                self._put_env(of_env, self.first)
        self.reporter.on_checkpoint(self.step, directory)

    def _check_terms(self) -> None:
        """Stops once a term of the last updates is no number; the env has waited for the device already."""
        if not self.sums or bool(torch.stack(list(self.sums.values())).isfinite().all()):
            return
        for key, value in self.sums.items():
            if not bool(value.isfinite()):
                raise self._diverged(f"'{key}' is {float(value)}")

    def _log(self, writers: list[MetricsWriter]) -> None:
        """Logs the means since the last logged step; waits for the device."""
        if self.logged_at == self.step:
            return
        self.logged_at = self.step
        self._check_terms()
        self.means = {key: float(value) / self.pending for key, value in self.sums.items()}
        self.sums, self.pending = {}, 0
        episodes = self.env.pop_statistics()
        row = self.means | episodes.means()
        if episodes.episodes:
            self.episodes = episodes
        if not row:
            return
        row |= {
            "episodes": episodes.episodes,
            "updates": self.updates,
            "steps_per_s": self._per_s(self.step - self.first_step) or 0.0,
            "updates_per_s": self._per_s(self.updates - self.first_update) or 0.0,
            "elapsed_s": self._elapsed(),
        }
        for writer in writers:
            writer.write(self.step, row)

    def _diverged(self, what: str) -> TrainingDivergedError:
        return TrainingDivergedError(
            f"{what} at environment step {self.step:,}, after {self.updates:,} updates. Take smaller "
            "learning rates of the policy, or look at the task's observations and rewards. "
            f"{checkpoint.what_is_kept(self.run_dir)}"
        )

    def _finish(self) -> TrainResult:
        result = TrainResult(
            checkpoint=self.run_dir / "checkpoints" / "last" / checkpoint.PRETRAINED,
            steps=self.step,
            loss=self.means.get("loss"),
            elapsed_s=self._elapsed(),
            samples_per_s=self._per_s((self.updates - self.first_update) * self.algorithm.batch_size),
            stopped_by="steps" if self._is_done() else "time_limit",
            precision="fp32",
            plot=plot_training(self.run_dir, self.algorithm.policy.name),
        )
        self.reporter.on_end(result)
        return result

    def _is_done(self) -> bool:
        return self.step >= self.config.steps and not self.algorithm.must_learn()

    def _crossed(self, every: int) -> bool:
        """Whether the last step went over a multiple of ``every``, and its updates are all made."""
        return self.step % every < self.env.num_envs and not self.algorithm.must_learn()

    def _elapsed(self) -> float:
        return self.elapsed_before + time.perf_counter() - self.start

    def _is_to_stop(self, interruption: Interruption) -> bool:
        limit = self.config.time_limit_s
        over = limit is not None and self._elapsed() >= limit
        return over or (bool(interruption) and self.algorithm.may_stop())

    def _per_s(self, count: int) -> float | None:
        return count / (time.perf_counter() - self.start) if count else None

    def _fraction(self) -> float:
        fraction = self.step / self.config.steps
        if self.config.time_limit_s is not None:
            fraction = max(fraction, self._elapsed() / self.config.time_limit_s)
        return min(fraction, 1.0)

    def _progress(self) -> Progress:
        seconds = time.perf_counter() - self.start
        return Progress(
            step=self.step,
            steps=self.config.steps,
            fraction=self._fraction(),
            loss=self.means.get("loss"),
            samples_per_s=self._per_s((self.updates - self.first_update) * self.algorithm.batch_size),
            elapsed_s=self._elapsed(),
            eta_s=seconds_left(self.config, self.step, self.first_step, seconds, self._elapsed()),
            success_rate=None if self.episodes is None else self.episodes.success_rate,
            episode_return=None if self.episodes is None else self.episodes.episode_return,
        )


def wanted(choice: bool | None, device: torch.device) -> bool:
    """Returns a choice, or whether the device is a GPU where None leaves it open."""
    return device.type == "cuda" if choice is None else choice
