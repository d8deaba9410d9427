"""Configuration of ``roboverse teleoperate``."""

from dataclasses import dataclass, field
from typing import Literal

from envs.core.errors import ConfigError
from envs.core.ranges import check_ranges
from envs.spec import MAX_IMAGE_SIZE, MIN_IMAGE_SIZE, EnvSpec

MAX_OPERATORS = 8


@dataclass(frozen=True, kw_only=True, slots=True)
class TeleoperateConfig:
    """``roboverse teleoperate``: a person at a browser steers the hand; successes become a LeRobot dataset.

    Attributes:
        env: Environment of the dataset: its images are rendered afterwards, at this level and size. Its
            fields are typed without ``env.``: ``task=PickCube``.
        preset: Named set of values from ``configs/preset``: cameras and size of the dataset's images.
        num_demos: Successes wanted, those of earlier runs included.
        datasets_dir: Folder of datasets.
        recordings: Folder of recordings, one file per episode; empty for one named after the task.
        dataset: Folder of the dataset; empty for one named after the configuration.
        render: Render the dataset at the end; without it, collect source=teleop does so later.
        operators: Environments, one for each person who opens the page.
        limit_s: Simulated seconds after which an episode is kept apart as a failure.
        view_size: Height and width of the page's images, pixels.
        view_cameras: Cameras that the page offers; empty takes all of the task's, and shows the first.
        view_shadows: Whether the page's images have shadows; by default where the machine has several cores.
        host: Address to listen at; 0.0.0.0 lets other machines in, all who have the page's address.
        port: Port to listen at; 0 takes any that is free.
        https: Serve the page over https, which phones and headsets demand before they steer, with ``cert`` or
            with a self-signed certificate, which the program openssl makes once.
        cert: PEM file of a certificate, for https.
        key: PEM file of the certificate's key.
        actor: ``person`` opens the page; ``expert`` lets the task's expert steer the hand without one.
        checkpoint: Folder of a run or checkpoint: its policy acts until the person takes over.
        device: Of the policy: auto, cpu, cuda.
    """

    env: EnvSpec = field(default_factory=EnvSpec)
    preset: str = "full"
    num_demos: int = 10
    datasets_dir: str = "datasets"
    recordings: str = ""
    dataset: str = ""
    render: bool = True
    operators: int = 1
    limit_s: float = 60.0
    view_size: int = 256
    view_cameras: tuple[str, ...] = ()
    view_shadows: bool | None = None
    host: str = "127.0.0.1"
    port: int = 8080
    https: bool = False
    cert: str = ""
    key: str = ""
    actor: Literal["person", "expert"] = "person"
    checkpoint: str = ""
    device: str = "auto"

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("num_demos", "limit_s"))
        if not 1 <= self.operators <= MAX_OPERATORS:
            raise ConfigError(f"operators must be 1 to {MAX_OPERATORS}, given {self.operators}.")
        if not 0 <= self.port <= 65535:
            raise ConfigError(f"port must be 0 to 65535, given {self.port}.")
        if not MIN_IMAGE_SIZE <= self.view_size <= MAX_IMAGE_SIZE:
            raise ConfigError(
                f"view_size must be {MIN_IMAGE_SIZE} to {MAX_IMAGE_SIZE} pixels, given {self.view_size}."
            )
        if bool(self.cert) != bool(self.key):
            raise ConfigError("https needs both cert=<file> and key=<file>, of PEM.")
