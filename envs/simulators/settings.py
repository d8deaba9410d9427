"""What a scenario says about one simulator, as that simulator's settings."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar, Self

from envs.core.errors import ConfigError, unknown_name, wrong_value
from envs.core.registry import Registry
from envs.scenario import ScenarioCfg

SETTINGS: Registry[type] = Registry("simulator")
"""Simulator to the dataclass of its settings, which is imported when it is first used."""

SETTINGS.add("mujoco", "envs.simulators.mujoco.settings:MujocoSettings")
SETTINGS.add("mujoco_warp", "envs.simulators.mujoco_warp.settings:WarpSettings")
SETTINGS.add("genesis", "envs.simulators.genesis.settings:GenesisSettings", extra="genesis")
SETTINGS.add("newton", "envs.simulators.newton.settings:NewtonSettings", extra="newton")
SETTINGS.add("pybullet", "envs.simulators.pybullet.settings:PybulletSettings", extra="pybullet")
SETTINGS.add("sapien", "envs.simulators.sapien.settings:SapienSettings", extra="sapien")


def check_settings(simulator: str, values: Mapping[str, Any]) -> None:
    """Checks settings of a simulator without starting it.

    Raises:
        ConfigError: if a setting has a value that it may not have.
        UnknownNameError: if there is no such setting, or no such value of one.
    """
    if not values:
        return
    from pydantic import TypeAdapter, ValidationError

    settings = SETTINGS.get(simulator)
    _check_names(simulator, settings, values)
    try:
        TypeAdapter(settings).validate_python(dict(values))
    except ValidationError as error:
        first = error.errors()[0]
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, ConfigError):
            raise cause from None
        where = ".".join(["simulator_settings", *map(str, first["loc"])])
        raise ConfigError(f"{where}: {wrong_value(first)}") from None


def _check_names(simulator: str, settings: type, values: Mapping[str, Any]) -> None:
    known = [field.name for field in fields(settings)]
    for name in values:
        if name not in known:
            raise unknown_name(f"setting of simulator={simulator}", name, known)


class SimulatorSettings:
    """Base of a simulator's settings: dataclasses whose fields may stand in ``simulators["<name>"]``.

    Attributes:
        simulator: Name of the block.
    """

    __slots__ = ()
    simulator: ClassVar[str]

    @classmethod
    def of(cls, scenario: ScenarioCfg) -> Self:
        """Reads a scenario's block, and sizes what it leaves open.

        Raises:
            ConfigError: if a setting has a value that it may not have.
            UnknownNameError: if there is no such setting, or no such value of one.
        """
        block: dict[str, Any] = dict(scenario.simulators.get(cls.simulator, {}))
        _check_names(cls.simulator, cls, block)
        return cls(**block).sized(scenario)

    def sized(self, scenario: ScenarioCfg) -> Self:
        """Returns these settings with a size in place of what depends on the scene."""
        return self
