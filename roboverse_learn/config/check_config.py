"""Configuration of ``roboverse check``."""

from dataclasses import dataclass, field

from envs.core.errors import ConfigError
from envs.spec import EnvSpec


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckConfig:
    """``roboverse check``: the contracts of a task, or of a policy or a robot that is named.

    Attributes:
        env: Environment of the task. Its fields are typed without ``env.``: ``task=PickCube``. Without a
            task and a policy, ``robot`` names a robot that is checked by itself.
        policy_name: Policy that is checked in place of the task, on the observations that the task gives.
        preset: Named set of values from ``configs/preset``: size of a policy and of its images.
        contracts: Contracts to look at, by name; empty takes all.
        without: Contracts to leave out.
        episodes: Starts of the test split that the expert is given.
        required: Share of them that the expert must solve.
        num_envs: Environments that step at once.
    """

    env: EnvSpec = field(default_factory=EnvSpec)
    policy_name: str = ""
    preset: str = "quick"
    contracts: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    episodes: int = 20
    required: float = 0.8
    num_envs: int = 3

    def __post_init__(self) -> None:
        for key in ("episodes", "num_envs"):
            if not 1 <= getattr(self, key) <= 1000:
                raise ConfigError(f"{key} must be 1 to 1000, given {getattr(self, key)}.")
        if not 0.0 <= self.required <= 1.0:
            raise ConfigError(f"required is a share from 0 to 1, given {self.required}.")
