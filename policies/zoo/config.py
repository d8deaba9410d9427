"""Settings of ``policy=lerobot``."""

from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from envs.core.errors import PolicyError
from envs.core.observation_keys import IMAGE_PREFIX
from policies.zoo.types import DROP_LAST_FRAMES, STATE_NOISE, check_settings, check_type

_OF_PRESET = ("lr", "weight_decay", "grad_clip", "betas")
"""Settings of training that LeRobot's preset decides."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PeftConfig:
    """Training of adapters in place of the whole network, as LeRobot's ``--peft.*``.

    Attributes:
        method_type: Method of the package peft, as LORA; empty trains the network itself.
        target_modules: Layers that get an adapter: their names, a regular expression, or all-linear. smolvla,
            pi0, pi05 and molmoact2 have a default, the others need it.
        full_training_modules: Modules beside them that are trained in full and saved with the adapters.
        init_type: How the adapters start; null takes the method's own.
        r: Rank of the adapters.
        lora_alpha: Scale of the adapters, which are weighted by lora_alpha / r; null takes peft's 8.
    """

    method_type: str = ""
    target_modules: str | list[str] | None = None
    full_training_modules: list[str] | None = None
    init_type: str | None = None
    r: int = 16
    lora_alpha: int | None = None

    def __post_init__(self) -> None:
        if self.r < 1:
            raise PolicyError(f"peft.r, the rank of the adapters, must be 1 or more, given {self.r}.")
        given = [f"peft.{item.name}" for item in fields(self) if getattr(self, item.name) != item.default]
        if given and not self.method_type:
            raise PolicyError(
                "peft.* without a method has no effect: add peft.method_type=LORA, or leave out "
                f"{' and '.join(given)}."
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class LeRobotConfig:
    """Any policy of LeRobot's registry; ``policy.<key>`` is every setting of its own configuration.

    Attributes:
        tasks: Further tasks that are learned together with the run's task, whose states and actions are as
            wide; task=[PickCube,StackCube] is the same.
        type: LeRobot's name of the policy, as smolvla, pi0, pi05, xvla or multi_task_dit; with ``path`` it
            may be left empty.
        path: Folder or hub name of a checkpoint to fine-tune; empty trains from the start.
        tokenizer: Folder of the tokenizer, in place of the one that LeRobot names.
        use_policy_training_preset: Train with the learning rate, moments, weight decay and clipping of
            LeRobot's configuration (policy.optimizer_*); false takes train.lr and its like.
        settings: LeRobot's own settings, typed as policy.<key>. Any type takes ``policy.drop_n_last_frames``:
            frames at the end of an episode that are no training samples of their own. Multi-Task DiT leaves
            out ``horizon - n_action_steps - n_obs_steps + 1``, GR00T one less than its actions, most none.
            With 0 a policy learns how an episode ends: actions after it repeat the last. Any type takes
            ``policy.state_noise``, too: standard deviation of the noise that training adds to the state, in
            standard deviations of the demonstrations; 0, the default, adds none.
        rename_map: Camera of the dataset to camera of the policy, as {front: camera1}.
        peft: Training of adapters.
    """

    open_field: ClassVar[str] = "settings"

    tasks: tuple[str, ...] = ()
    type: str = ""
    path: str = ""
    tokenizer: str = ""
    use_policy_training_preset: bool = True
    settings: dict[str, Any] = field(default_factory=dict)
    rename_map: dict[str, str] = field(default_factory=dict)
    peft: PeftConfig = field(default_factory=PeftConfig)

    def __post_init__(self) -> None:
        if self.type:
            check_type(self.type)
            check_settings(self.type, self.settings)
        full_rename_map(self.rename_map)
        dropped = self.settings.get(DROP_LAST_FRAMES)
        if dropped is not None and (not isinstance(dropped, int) or dropped < 0):
            raise PolicyError(f"policy.{DROP_LAST_FRAMES} must be a whole number from 0 on, given {dropped}.")
        noise = self.settings.get(STATE_NOISE, 0)
        if not isinstance(noise, int | float) or not 0.0 <= noise < float("inf"):
            raise PolicyError(f"policy.{STATE_NOISE} must be 0 (off) or more, given {noise}.")
        if self.peft.method_type and not self.path:
            raise PolicyError(
                "peft.* adapts a trained policy: give policy.path=<folder or hub name>, or leave out "
                "peft.* to train a policy from the start."
            )

    def check_training(self, train: Any) -> None:
        """Checks that training is given no setting that LeRobot's preset decides.

        Args:
            train: A :class:`roboverse_learn.training.config.TrainConfig`.

        Raises:
            PolicyError: if one is.
        """
        if self.use_policy_training_preset:
            check_preset(train)


def check_preset(train: Any) -> None:
    """Checks that no setting that LeRobot's preset decides was changed.

    Args:
        train: A :class:`roboverse_learn.training.config.TrainConfig`.

    Raises:
        PolicyError: if one was.
    """
    defaults = type(train)()
    changed = [key for key in _OF_PRESET if getattr(train, key) != getattr(defaults, key)]
    if changed:
        raise PolicyError(
            f"{', '.join(f'train.{key}' for key in changed)} would have no effect: LeRobot's preset of the "
            "policy decides it. Change the preset, as in policy.optimizer_lr=1e-5, or add "
            "policy.use_policy_training_preset=false."
        )


def full_rename_map(given: dict[str, str]) -> dict[str, str]:
    """Returns a map of cameras with the keys of observations: ``front`` is ``observation.images.front``.

    Raises:
        PolicyError: if two cameras become the same one.
    """
    full = {_key(source): _key(target) for source, target in given.items()}
    if len(set(full.values())) < len(full):
        raise PolicyError(f"rename_map={given} gives two cameras the same name. Give each its own.")
    return full


def _key(name: str) -> str:
    return name if name.startswith("observation.") else IMAGE_PREFIX + name
