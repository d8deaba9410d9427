"""Configuration of the commands beside collect, train, sweep and evaluate; see :mod:`.schema`."""

import keyword
import re
from dataclasses import dataclass, field
from typing import Literal

from envs.core.errors import ConfigError, unknown_name
from envs.core.ranges import check_ranges
from envs.spec import MAX_IMAGE_SIZE, MIN_IMAGE_SIZE, EnvSpec

Split = Literal["train", "validation", "test"]
Replay = Literal["states", "controls"]

NEW_KINDS = ("task", "policy", "robot")
"""What a skeleton can be made of."""

_NEW_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_NEW_EXAMPLES = {"task": "LiftBlock", "policy": "my_cnn", "robot": "my_arm"}

MAX_OPERATORS = 8


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


@dataclass(frozen=True, kw_only=True, slots=True)
class NewConfig:
    """``roboverse new task name=LiftBlock``: a package with a working task, policy or robot to start from.

    Attributes:
        kind: What is made: task, policy or robot; typed as the first word alone.
        name: Name by which commands will know it: letters, digits and underscores.
        out: Folder to write, which must not exist; empty for one named after the package.
    """

    kind: str = "task"
    name: str = ""
    out: str = ""

    def __post_init__(self) -> None:
        if self.kind not in NEW_KINDS:
            hint = "As in: roboverse new task name=LiftBlock"
            raise unknown_name("kind of skeleton", self.kind, NEW_KINDS, hint)
        example = f"as in: roboverse new {self.kind} name={_NEW_EXAMPLES[self.kind]}"
        if not self.name:
            raise ConfigError(f"new {self.kind} needs name=<name>, {example}")
        if not _NEW_NAME.fullmatch(self.name):
            raise ConfigError(
                f"name={self.name} is no name of letters, digits and underscores that begins with a letter, "
                f"{example}"
            )
        if keyword.iskeyword(self.module) or keyword.iskeyword(self.class_name):
            raise ConfigError(f"name={self.name} is a word of Python. Choose another one, {example}")

    @property
    def module(self) -> str:
        """Name of the package: ``lift_block`` for ``LiftBlock``."""
        parts = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", self.name)
        return re.sub(r"_+", "_", parts).strip("_").lower()

    @property
    def class_name(self) -> str:
        """Name of its class: ``LiftBlock`` for ``lift_block``."""
        return "".join(part[:1].upper() + part[1:] for part in self.name.split("_"))

    @property
    def folder(self) -> str:
        """The folder that is written."""
        return self.out or self.module


@dataclass(frozen=True, kw_only=True, slots=True)
class ConvertConfig:
    """``roboverse convert``: a robot's MJCF as URDF or USD, or its URDF as MJCF.

    Attributes:
        robot: Registered robot, file, or asset such as robosuite:models/assets/robots/ur5e/robot.xml.
        to: Format: urdf, usd (needs usd-core), or mjcf for a robot whose file is URDF.
        root: Body of the file that is the robot, where the file holds several; empty for all of it.
        simplify: Merge and simplify the visual meshes of a registered robot.
        packages: Folder of the ROS packages that a URDF file names (package://); empty looks in the folders
            above the file.
        out: Folder to write to; empty for the cache, whose folder is named after the content.
    """

    robot: str = "franka"
    to: str = "urdf"
    root: str = ""
    simplify: bool = False
    packages: str = ""
    out: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportConfig:
    """``roboverse export``: a checkpoint as a folder that ``lerobot-rollout`` runs on a real robot.

    Attributes:
        checkpoint: Run, or a checkpoint of it.
        to: Robot of LeRobot's (``--robot.type``); the one that the checkpoint's data have the units of.
        out: Folder to write to; empty for exports/<robot>/<run>.
    """

    checkpoint: str = ""
    to: str = "so101_follower"
    out: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class PublishConfig:
    """``roboverse publish``: a checkpoint or a dataset on the Hugging Face hub, with a page about it.

    Attributes:
        checkpoint: Run, or a checkpoint of it.
        dataset: Folder of a dataset.
        to: Name on the hub, owner/name; it may exist.
        private: Make a new repository that only its owner sees; a public one of this name is refused.
        license: Licence on its page, in the hub's words, as apache-2.0 or cc-by-4.0; empty for none.
        results_dir: Folder of the checkpoint's results, which its page shows.
        dry_run: Show the page alone; nothing is uploaded.
    """

    checkpoint: str = ""
    dataset: str = ""
    to: str = ""
    private: bool = False
    license: str = ""
    results_dir: str = "results"
    dry_run: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplayConfig:
    """``roboverse replay``: replays recorded episodes in another simulator, by states and by controls.

    Attributes:
        dataset: Folder of a dataset that was collected here.
        simulator: Registered simulator that replays.
        by: states sets every recorded state, controls gives the recorded actions.
        episodes: Episodes of the dataset, from the first on; 0 takes all.
        num_envs: Environments that step at once.
        note: Remark on the page, such as why few replays succeed.
        out: Folder that gets the summary, the plots and the page of all its summaries.
    """

    dataset: str = ""
    simulator: str = "mujoco"
    by: tuple[Replay, ...] = ("states", "controls")
    episodes: int = 0
    num_envs: int = 10
    note: str = ""
    out: str = "replays"

    def __post_init__(self) -> None:
        if not self.dataset:
            raise ConfigError("replay needs dataset=<folder>, as in dataset=datasets/PickCube/<name>.")
        if not self.by:
            raise ConfigError("replay needs a way, as in by=[states,controls].")
        check_ranges(self, above_0=("num_envs",), from_0=("episodes",))


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewConfig:
    """``roboverse view``: one episode in the Rerun viewer: 3D scene over time, images, randomization draws.

    Attributes:
        env: Environment of the task's expert. Its fields are typed without ``env.``: ``task=PickCube``.
        dataset: Folder of a dataset that was collected here; views a recorded episode instead.
        result: Results file of an evaluation; views one of its videos instead.
        episode: Which episode of the split or the dataset, or which of the result's videos, from 0.
        split: Split of the expert's episode.
        protocol_seed: Seed of the expert's episode.
        file: Recording to write, such as ``episode.rrd``; empty opens the browser. Without a display, the
            file is view.rrd.
    """

    env: EnvSpec = field(default_factory=EnvSpec)
    dataset: str = ""
    result: str = ""
    episode: int = 0
    split: Split = "train"
    protocol_seed: int = 0
    file: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, from_0=("episode", "protocol_seed"))
        given = [f"{key}={getattr(self, key)}" for key in ("dataset", "result") if getattr(self, key)]
        if given and (len(given) > 1 or self.env.replace(materials="") != EnvSpec()):
            raise ConfigError(
                f"{' and '.join(given)} cannot be combined with others: view takes dataset=, result=, "
                "or the keys of an environment, such as task= and level=. Give one of them."
            )
        if self.file and not self.file.endswith(".rrd"):
            raise ConfigError(f"file={self.file} must end in .rrd, the format of the Rerun viewer.")


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


@dataclass(frozen=True, kw_only=True, slots=True)
class ConservationConfig:
    """``roboverse conservation``: tests conservation of momentum and energy on each simulator.

    Attributes:
        simulators: Registered simulators, as in simulators=[mujoco]; empty takes all that are installed.
        timestep_s: Time step of physics.
        out: Folder of the results, plots and the page.
    """

    simulators: tuple[str, ...] = ()
    timestep_s: float = 0.005
    out: str = "conservation"

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("timestep_s",))


@dataclass(frozen=True, kw_only=True, slots=True)
class LeaderboardConfig:
    """``roboverse leaderboard``: tables, plots and page from the result files alone.

    Attributes:
        results_dir: Folder of results and of the leaderboard.
        prune_videos: Whether to remove videos: one success and one failure stay per entry and level, and
            what ``keep_videos.txt`` in the folder names.
    """

    results_dir: str = "results"
    prune_videos: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class DoctorConfig:
    """``roboverse doctor``: the machine, the installation, and what works here.

    Attributes:
        json: Print JSON instead of text.
        speed: Also measure images, environment steps and training per second, which takes most of the time.
    """

    json: bool = False
    speed: bool = True
