"""Registry of the simulators' settings, and their check before a simulator starts."""

from collections.abc import Mapping
from typing import Any

from envs.core.registry import Registry
from envs.scenario.simulator_settings import SimulatorSettings
from envs.scenario.typed_settings import typed_settings

SETTINGS: Registry[type[SimulatorSettings]] = Registry("simulator")
"""Simulator to the dataclass of its settings, which is imported on first use."""

SETTINGS.add("mujoco", "envs.mjcf.settings:MujocoSettings")
SETTINGS.add("mujoco_warp", "envs.simulators.mujoco_warp.settings:WarpSettings")
SETTINGS.add("genesis", "envs.simulators.genesis.settings:GenesisSettings", extra="genesis")
SETTINGS.add("newton", "envs.simulators.newton.settings:NewtonSettings", extra="newton")
SETTINGS.add("pybullet", "envs.simulators.pybullet.settings:PybulletSettings", extra="pybullet")
SETTINGS.add("sapien", "envs.simulators.sapien.settings:SapienSettings", extra="sapien")


def check_settings(simulator: str, values: Mapping[str, Any]) -> None:
    """Checks settings of a simulator without starting it.

    Raises:
        ConfigError: if a setting has an invalid value.
        UnknownNameError: if there is no such setting, or no such value of one.
    """
    if values:
        typed_settings(SETTINGS.get(simulator), values, "simulator_settings", f"simulator={simulator}")
