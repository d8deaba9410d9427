"""What a scenario says about one simulator, as that simulator's settings."""

from dataclasses import fields
from typing import Any, ClassVar, Self

from envs.errors import unknown_name
from envs.scenario import ScenarioCfg


class SimulatorSettings:
    """Base of a simulator's settings: dataclasses whose fields may stand in ``simulators["<name>"]``.

    Attributes:
        simulator: Name of the block.
    """

    __slots__ = ()
    simulator: ClassVar[str]

    @classmethod
    def of(cls, scenario: ScenarioCfg) -> Self:
        """Reads a scenario's block.

        Raises:
            ConfigError: if a setting has a value that it may not have.
            UnknownNameError: if there is no such setting, or no such value of one.
        """
        block: dict[str, Any] = dict(scenario.simulators.get(cls.simulator, {}))
        known = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        for name in block:
            if name not in known:
                raise unknown_name(f"setting of {cls.simulator}", name, known)
        return cls(**block)
