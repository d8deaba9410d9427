"""Settings of OpenVLA."""

from dataclasses import dataclass, field

from policies.zoo.config import PeftConfig

IMAGE_PX = 224
"""Pixels a side of what OpenVLA sees (image_sizes of its published configuration)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenVlaConfig:
    """OpenVLA, arXiv:2406.09246, fine-tuned from a published checkpoint.

    Attributes:
        tasks: Further tasks that are learned together with the run's task, whose states and actions are as
            wide; task=[PickCube,StackCube] is the same.
        path: Folder or hub name of the checkpoint to fine-tune, as openvla/openvla-7b (15 GB).
        camera: Camera of the dataset that it sees, of which there is one; empty takes the first.
        unnorm_key: Name of the dataset's statistics in the checkpoint (norm_stats).
        peft: Training of adapters; its authors take LORA with r=32 and lora_alpha=16 on all linear layers.
    """

    tasks: tuple[str, ...] = ()
    path: str = ""
    camera: str = ""
    unnorm_key: str = "roboverse"
    peft: PeftConfig = field(default_factory=PeftConfig)
