"""The physics of N worlds in one ``mujoco_warp`` model, as torch tensors that share its memory."""

import contextlib
import io
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp
from torch import Tensor

from envs.core.errors import SimulatorError
from envs.simulators.mujoco_warp.device import Device
from envs.simulators.mujoco_warp.settings import SIMULATOR, WarpSettings

_STATE = ("qpos", "qvel", "act", "qacc_warmstart", "time", "ctrl", "mocap_pos", "mocap_quat")
"""Everything that the future of a world depends on."""

_INPUTS = ("ctrl", "mocap_pos", "mocap_quat")
"""The part of it that stepping never writes."""

_SETTING_OF = {
    mjw.OverflowType.NEFC: "njmax",
    mjw.OverflowType.NJMAX_NNZ: "njmax",
    mjw.OverflowType.BROADPHASE: "nconmax",
    mjw.OverflowType.NARROWPHASE: "nconmax",
    mjw.OverflowType.CCD: "nccdmax",
}
"""Which setting is too small. The other flags are no buffers of ours: iteration limits, sensors."""

_BUFFERS = int(sum(_SETTING_OF))


@wp.kernel
def _come_nearer(left: Any):
    left[0] = left[0] - 1


@wp.kernel
def _move_targets(goal: Any, way: Any, left: Any, ctrl: Any):
    world, actuator = wp.tid()  # type: ignore[misc] (as many indices as the launch has dimensions)
    ctrl[world, actuator] = goal[world, actuator] - float(left[0]) * way[world, actuator]


@dataclass(frozen=True, slots=True)
class WorldViews:
    """Tensors that are the simulator's own memory, float32, on its device: write with care, read at once.

    Attributes:
        qpos: Joint positions, (N, nq).
        qvel: Joint velocities, (N, nv).
        ctrl: Actuator targets, (N, nu).
        mocap_pos: Positions of the bodies that are put in place, (N, nmocap, 3).
        mocap_quat: Their orientations, wxyz, (N, nmocap, 4).
        site_xpos: Sites' positions in the world, (N, nsite, 3).
        site_xmat: Their orientations, (N, nsite, 3, 3).
        sensordata: What sensors say, (N, nsensordata).
    """

    qpos: Tensor
    qvel: Tensor
    ctrl: Tensor
    mocap_pos: Tensor
    mocap_quat: Tensor
    site_xpos: Tensor
    site_xmat: Tensor
    sensordata: Tensor


class Worlds:
    """N worlds that step together.

    Args:
        model: The compiled scene.
        num_envs: N.
        device: Where.
        settings: Sizes of the buffers.

    Attributes:
        views: See :class:`WorldViews`.
        num_resets: How often each world was put back because its state was no longer finite, (N,) int64.

    Raises:
        SimulatorError: if the scene has something that mujoco_warp has no code for.
    """

    def __init__(self, model: mujoco.MjModel, num_envs: int, device: Device, settings: WarpSettings) -> None:
        self._device, self._settings = device, settings
        with device.scope(), contextlib.redirect_stdout(io.StringIO()):
            self.model = put_model(model)
            # Overflows are read from their flags and raised, not printed.
            self.model.opt.warn_overflow = 0
            if settings.deterministic and device.is_cuda:
                self.model.opt.deterministic = int(mjw.DeterminismType.ALL)
            self.data = mjw.make_data(
                model,
                nworld=num_envs,
                nconmax=settings.nconmax,
                njmax=settings.njmax,
                nccdmax=settings.nccdmax,
            )
        self._state = {name: device.tensor(getattr(self.data, name)) for name in _STATE}
        self.views = WorldViews(
            **{
                name: device.tensor(getattr(self.data, name))
                for name in WorldViews.__dataclass_fields__  # type: ignore[attr-defined]
            }
        )
        self._overflow = device.tensor(self.data.overflow)
        self.num_resets = torch.zeros(num_envs, dtype=torch.int64, device=device.torch)
        self._start = {name: value.clone() for name, value in self._state.items()}
        self._goal = wp.zeros_like(self.data.ctrl)
        self._way = wp.zeros_like(self.data.ctrl)
        self._left = wp.zeros(1, dtype=wp.int32, device=device.warp)
        self._step = device.capture(lambda: mjw.step(self.model, self.data))
        self._launch_targets()  # kernels that fit any array are compiled for ours before they are recorded
        self._step_on_the_way = device.capture(self._launch_on_the_way)
        self._pose = device.capture(lambda: mjw.kinematics(self.model, self.data))

    def begin(self, rows: Any) -> None:
        """Makes the present state the start of these worlds: nothing of the past is left."""
        self._state["qacc_warmstart"][rows] = 0.0
        self._state["time"][rows] = 0.0
        self.views.sensordata[rows] = 0.0
        for name, value in self._state.items():
            self._start[name][rows] = value[rows]
        self._overflow[rows] = 0
        self.pose()

    def pose(self) -> None:
        """Brings the positions of bodies and sites up to date with ``qpos``."""
        self._pose.launch()

    def _launch_on_the_way(self) -> None:
        self._launch_targets()
        mjw.step(self.model, self.data)

    def _launch_targets(self) -> None:
        data = self.data
        wp.launch(_come_nearer, 1, inputs=[self._left], device=self._device.warp)
        wp.launch(
            _move_targets,
            data.ctrl.shape,
            inputs=[self._goal, self._way, self._left],
            outputs=[data.ctrl],
            device=self._device.warp,
        )

    def step(self, num_steps: int, rows: Any = None, start: Tensor | None = None) -> Tensor:
        """Steps the worlds ``rows`` (None: all, the fast way) by ``num_steps``.

        Args:
            num_steps: How often.
            rows: Indices of worlds.
            start: Targets of all actuators (N, nu) that were; they move evenly from there to those that are
                set, and are there in the last step. None holds those that are set.

        Returns:
            Indices of worlds whose state was no longer finite and that are back at their start.

        Raises:
            SimulatorError: if a buffer was too small; it names the setting.
        """
        frozen = None if rows is None else self._others(rows)
        kept = {k: v.clone() for k, v in self._state.items() if k not in _INPUTS} if rows is not None else {}
        if start is None:
            self._step.launch(num_steps)
        else:
            tensor = self._device.tensor
            tensor(self._goal).copy_(self.views.ctrl)
            tensor(self._way).copy_((self.views.ctrl - start) / num_steps)
            tensor(self._left).fill_(num_steps)
            self._step_on_the_way.launch(num_steps)
        if frozen is not None:
            for name, value in kept.items():
                target = self._state[name]
                target.copy_(torch.where(_beside(frozen, target), value, target))
            self._overflow.masked_fill_(frozen, 0)
        lost = self._restart_lost(frozen)
        self.pose()
        return lost

    def _others(self, rows: Any) -> Tensor:
        frozen = torch.ones(len(self._overflow), dtype=torch.bool, device=self._device.torch)
        frozen[rows] = False
        return frozen

    def _restart_lost(self, frozen: Tensor | None) -> Tensor:
        """Checks every world once, with a single transfer if all are finite."""
        state = self._state
        # A sum is finite exactly when every entry is (no overflow at physical magnitudes).
        total = state["qpos"].sum(-1) + state["qvel"].sum(-1) + state["ctrl"].sum(-1)
        lost = ~torch.isfinite(total)
        if frozen is not None:
            lost &= ~frozen
        full = (self._overflow & _BUFFERS).masked_fill(lost, 0)
        any_lost, any_full = torch.stack((lost.any(), full.any())).tolist()
        if any_full:
            self._overflow.zero_()
            raise SimulatorError(_overflow_message(full, self._settings))
        if not any_lost:
            return lost.nonzero()[:0, 0]
        ids = lost.nonzero()[:, 0]
        for name, value in self._state.items():
            value[ids] = self._start[name][ids]
        self._overflow[ids] = 0
        self.num_resets[ids] += 1
        return ids


def put_model(model: mujoco.MjModel, batch_sizes: dict[str, int] | None = None) -> Any:
    """Puts a model on Warp's present device.

    Args:
        model: The compiled scene.
        batch_sizes: Field to the number of worlds that have their own values of it.

    Raises:
        SimulatorError: if mujoco_warp has no code for something in it; it says for what.
    """
    try:
        return mjw.put_model(model, batch_sizes=batch_sizes)
    except (NotImplementedError, ValueError) as error:
        raise SimulatorError(
            f"simulator={SIMULATOR} cannot run this scene: {error} Use simulator=mujoco, or change the scene."
        ) from error


def _beside(mask: Tensor, value: Tensor) -> Tensor:
    """Returns a mask (N,) in a shape that broadcasts with ``value`` (N, …)."""
    return mask.view(-1, *(1,) * (value.ndim - 1))


def _overflow_message(full: Tensor, settings: WarpSettings) -> str:
    ids = full.nonzero()[:, 0].tolist()
    bits = 0
    for flags in full[ids].tolist():
        bits |= flags
    advice = []
    for name in dict.fromkeys(setting for flag, setting in _SETTING_OF.items() if bits & flag):
        size = getattr(settings, name) or settings.nconmax or 0
        advice.append(f"simulator_settings.{name}={2 * size} (it is {size})")
    shown = ", ".join(map(str, ids[:8])) + ("…" if len(ids) > 8 else "")
    return (
        f"A buffer of mujoco_warp was too small for environments {shown}; the step lost contacts. "
        f"Add {' and '.join(advice)} to the command, or say so in the scenario's simulators['{SIMULATOR}']."
    )
