"""PickCube for agents on bare ``mujoco_warp``: the baseline of our env.

It has the same scene, actions, size of the observation and length of the episodes, but no checks, no
success, and the simplest reward. Shapes: N environments.
"""

import torch
from torch import Tensor

from envs.controllers import HandDeltaController
from envs.torch_env import EnvStep
from roboverse_learn.speed.mujoco_warp import put_physics
from roboverse_learn.speed.simulators import launched

_HORIZON = 100
_STATE = ("qpos", "qvel", "ctrl", "mocap_pos")


class BareEnv:
    """What PPO needs of a :class:`~envs.torch_env.TorchEnv`; every episode starts from the env's own state.

    Args:
        num_envs: N.
        device: Torch device, or ``auto``.
    """

    action_size, max_episode_steps = 5, _HORIZON

    def __init__(self, num_envs: int, device: str = "auto") -> None:
        import mujoco_warp as mjw

        # Our handler compiles the model and samples the initial states; it does not step.
        handler = launched("mujoco_warp", num_envs, settings={"device": device})
        self._on, self.num_envs, self.device = handler.on, num_envs, handler.on.torch
        self._model, self._data = put_physics(handler)
        self._graph = self._on.capture(lambda: mjw.step(self._model, self._data))
        self._views = {name: self._on.tensor(getattr(self._data, name)) for name in (*_STATE, "site_xpos")}
        self._start = {name: getattr(handler.views, name).clone() for name in _STATE}
        scenario, model = handler.scenario, handler.physics_model
        handler.close()
        self._low, self._high = torch.from_numpy(model.actuator_ctrlrange.T.copy()).to(self._views["ctrl"])
        robot, self._decimation = scenario.robots[0], scenario.physics.decimation
        self._controller = HandDeltaController(robot)
        self._hand = model.site(f"{robot.name}/{robot.ee_site}").id
        self.elapsed_steps = torch.zeros(num_envs, dtype=torch.long, device=self.device)
        self.observation_size = self.reset().shape[-1]

    def reset(self, mask: Tensor | None = None) -> Tensor:
        """Starts new episodes everywhere, or where ``mask`` (N,) says so."""
        over = torch.ones_like(self.elapsed_steps, dtype=torch.bool) if mask is None else mask
        for name, start in self._start.items():
            view = self._views[name]
            view.copy_(torch.where(over.view(-1, *[1] * (start.ndim - 1)), start, view))
        self.elapsed_steps[over] = 0
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

    def _observe(self) -> Tensor:
        views = self._views
        gap = views["qpos"][:, 7:9].sum(-1, keepdim=True)
        parts = (views["qpos"], views["qvel"], views["ctrl"], views["mocap_pos"][:, 0], gap)
        return torch.cat((*parts, views["site_xpos"][:, self._hand]), -1)
