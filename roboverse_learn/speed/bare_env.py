"""PickCube for agents on bare ``mujoco_warp``: the baseline of our env.

It has the same scene, actions, size of the observation and length of the episodes, but no checks, no
success, and the simplest reward. Shapes: N environments.
"""

from typing import Any

import torch
from torch import Tensor

from envs.controllers import HandDeltaController
from envs.torch_env import EnvStep, EpisodeStatistics
from roboverse_learn.speed.mujoco_warp import make_handler, put_physics

_HORIZON = 100


class BareEnv:
    """See :class:`~envs.torch_env.TorchEnv`.

    Args:
        num_envs: N.
        device: Torch device, or ``auto``.
    """

    action_size, max_episode_steps = 5, _HORIZON

    def __init__(self, num_envs: int, device: str = "auto") -> None:
        import mujoco_warp as mjw

        # Our handler compiles the model and samples the initial states; it does not step.
        handler, scenario = make_handler(num_envs, device)
        self._on, self.num_envs, self.device = handler.on, num_envs, handler.on.torch
        model = handler.physics_model
        self._model, self._data = put_physics(handler)
        self._graph = self._on.capture(lambda: mjw.step(self._model, self._data))
        views = {name: self._on.tensor(getattr(self._data, name)) for name in (*_STATE, "site_xpos")}
        self._views: dict[str, Tensor] = views
        self._start = {name: getattr(handler.views, name).clone() for name in _STATE}
        handler.close()
        limits = torch.from_numpy(model.actuator_ctrlrange.T.copy()).to(views["ctrl"])
        self._low, self._high, self._decimation = limits[0], limits[1], scenario.physics.decimation
        robot = scenario.robots[0]
        self._controller = HandDeltaController(robot)
        self._hand = model.site(f"{robot.name}/{robot.ee_site}").id
        self.elapsed_steps = torch.zeros(num_envs, dtype=torch.long, device=self.device)
        self.observation_size = self.reset().shape[-1]

    def seed(self, seed: int) -> None:
        """Does nothing: every environment always starts from its own state."""
        del seed

    def reset(self, mask: Tensor | None = None) -> Tensor:
        """Starts new episodes everywhere, or where ``mask`` (N,) says so."""
        for name, view in self._views.items():
            if name in self._start:
                start = self._start[name]
                chosen = start if mask is None else torch.where(_beside(mask, start), start, view)
                view.copy_(chosen)
        if mask is None:
            self.elapsed_steps.zero_()
        else:
            self.elapsed_steps[mask] = 0
        return self._observe()

    def step(self, actions: Tensor) -> EnvStep:
        """Steps every environment."""
        views = self._views
        targets = self._controller.targets(views["qpos"][:, :9], actions.detach())
        with self._on.scope():
            views["ctrl"].copy_(targets.clamp(self._low, self._high))
            self._graph.launch(self._decimation)
        final = self._observe()
        gap = torch.linalg.vector_norm(views["site_xpos"][:, self._hand] - views["qpos"][:, 9:12], dim=-1)
        self.elapsed_steps += 1
        over = self.elapsed_steps >= _HORIZON
        none = torch.zeros_like(over)
        return EnvStep(self.reset(over), 1.0 - torch.tanh(5.0 * gap), none, over, final, none)

    def stagger(self) -> None:
        """Sets a random elapsed time in every environment."""
        self.elapsed_steps = torch.randint(_HORIZON, (self.num_envs,), device=self.device)

    def pop_statistics(self) -> EpisodeStatistics:
        """Returns empty statistics."""
        return EpisodeStatistics(0, float("nan"), float("nan"), float("nan"))

    def close(self) -> None:
        """Does nothing."""

    def _observe(self) -> Tensor:
        views: Any = self._views
        gap = views["qpos"][:, 7:9].sum(-1, keepdim=True)
        parts = (views["qpos"], views["qvel"], views["ctrl"], views["mocap_pos"][:, 0], gap)
        return torch.cat((*parts, views["site_xpos"][:, self._hand]), -1)


_STATE = ("qpos", "qvel", "ctrl", "mocap_pos")


def _beside(mask: Tensor, values: Tensor) -> Tensor:
    return mask.view(-1, *[1] * (values.ndim - 1))
