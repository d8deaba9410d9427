"""Settings of Octo."""

from dataclasses import dataclass, field
from typing import Literal

from envs.core.errors import PolicyError
from envs.core.ranges import check_ranges
from policies.zoo.config import PeftConfig

TRAINED = ("full", "head")


@dataclass(frozen=True, kw_only=True, slots=True)
class OctoConfig:
    """Octo, arXiv:2405.12213, fine-tuned from a converted checkpoint.

    Attributes:
        tasks: Further tasks that are learned together with the run's task, whose states and actions are as
            wide; task=[PickCube,StackCube] is the same.
        path: Folder of the checkpoint, as policies/octo/convert.py writes it.
        primary: Camera of the dataset in the place of the scene's; empty takes the first.
        wrist: Camera in the place of the wrist's; empty leaves it out.
        window: Observations that it looks at; its authors fine-tune with 1.
        chunk_size: Actions that it predicts, of which all are executed; another number than the checkpoint's
            4, or actions of another width, begin with a new head.
        trained: full trains everything but the text encoder; head trains the diffusion head alone.
        peft: Training of adapters in place of the network; the diffusion head is trained in full beside them.
    """

    tasks: tuple[str, ...] = ()
    path: str = ""
    primary: str = ""
    wrist: str = ""
    window: int = 1
    chunk_size: int = 4
    trained: Literal["full", "head"] = "full"
    peft: PeftConfig = field(default_factory=PeftConfig)

    def __post_init__(self) -> None:
        if self.trained not in TRAINED:
            raise PolicyError(f"policy.trained is {' or '.join(TRAINED)}, given {self.trained}.")
        if self.trained == "head" and self.peft.method_type:
            raise PolicyError("policy.trained=head trains no adapters: leave it out, or leave out peft.*")
        check_ranges(self, "policy.", from_1=("window", "chunk_size"), error=PolicyError)
