"""Base class of the settings that a scenario holds for one simulator."""

from typing import Any, ClassVar, Self

from envs.scenario import ScenarioCfg
from envs.scenario.typed_settings import check_names


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
        check_names(cls, values, f"simulator={cls.simulator}")
        return cls(**values).sized(scenario)

    def sized(self, scenario: ScenarioCfg) -> Self:
        """Returns these settings with the sizes set that depend on the scene."""
        return self
