"""Base class of the settings that a scenario holds for one simulator."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar, Self

from envs.core.errors import unknown_name
from envs.scenario import ScenarioCfg


class SimulatorSettings:
    """Base of a simulator's settings: dataclasses whose fields are the keys of ``simulators["<name>"]``.

    Attributes:
        simulator: Name of the simulator.
    """

    __slots__ = ()
    simulator: ClassVar[str]

    @classmethod
    def of(cls, scenario: ScenarioCfg) -> Self:
        """Reads a scenario's settings, and sets the sizes that depend on the scene.

        Raises:
            ConfigError: if a setting has an invalid value.
            UnknownNameError: if there is no such setting, or no such value of one.
        """
        values: dict[str, Any] = dict(scenario.simulators.get(cls.simulator, {}))
        cls.check_names(values)
        return cls(**values).sized(scenario)

    @classmethod
    def check_names(cls, values: Mapping[str, Any]) -> None:
        """Checks the names of settings.

        Raises:
            UnknownNameError: if there is no such setting.
        """
        known = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        for name in values:
            if name not in known:
                raise unknown_name(f"setting of simulator={cls.simulator}", name, known)

    def sized(self, scenario: ScenarioCfg) -> Self:
        """Returns these settings with the sizes set that depend on the scene."""
        return self
