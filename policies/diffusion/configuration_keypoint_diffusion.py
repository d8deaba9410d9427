"""LeRobot's configuration of Diffusion Policy over image keypoints: ``--policy.type=keypoint_diffusion``.

LeRobot finds the model and the processors of a policy type in the modules ``modeling_<type>`` and
``processor_<type>`` beside the module of its configuration.
"""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig as LeRobotDiffusionConfig

from policies.diffusion.config import DiffusionConfig


@PreTrainedConfig.register_subclass("keypoint_diffusion")
@dataclass
class KeypointDiffusionConfig(LeRobotDiffusionConfig):
    """LeRobot's Diffusion Policy with small convolutions in place of ResNets; their settings have no effect.

    Attributes:
        conv_channels: Channels of each convolution of a camera's backbone, see
            :class:`policies.act.configuration_keypoint_act.KeypointActConfig`.
        n_residual_blocks: Residual blocks of two convolutions each that follow these.
        use_group_norm: True, as the small convolutions have it.
        pretrained_backbone_weights: None: there are none.

    Raises:
        PolicyError: A size is out of range; see :class:`policies.diffusion.config.DiffusionConfig`.
    """

    conv_channels: tuple[int, ...] = (32, 32, 64)
    n_residual_blocks: int = 0
    use_group_norm: bool = True
    pretrained_backbone_weights: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        DiffusionConfig(  # checks them
            vision_backbone="keypoints",
            n_obs_steps=self.n_obs_steps,
            horizon=self.horizon,
            n_action_steps=self.n_action_steps,
            down_dims=tuple(self.down_dims),
            conv_channels=tuple(self.conv_channels),
            n_residual_blocks=self.n_residual_blocks,
            spatial_softmax_num_keypoints=self.spatial_softmax_num_keypoints,
        )
