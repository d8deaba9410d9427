"""A valid value of every key of a configuration, other than its default."""

from typing import Any

CHOSEN = {
    "task": "PickCube",
    "preset": "quick",
    "simulator": "mujoco",
    "renderer": "gl",
    "policy_name": "diffusion",
    "only": "camera",
    "kind": "robot",
    "name": "my_arm",
    "contracts": ["scene"],
    "without": ["at_rest"],
    "level": 2,
    "cameras": ["wrist"],
    "image_size": 96,
    "train.precision": "fp32",
    "train.schedule": "constant",
    "train.lr_backbone": 1e-6,
    "split": "test",
    "file": "episode.rrd",
    "source": "maniskill",
    "replay": "controls",
    "by": ["states"],
    "simulators": ["mujoco"],
    "train.ema": True,
    "train.compile": False,
    "train.time_limit_s": 12.5,
    "evaluate.levels": [3],
    "evaluate.alone": ["lighting"],
    "evaluate.instructions": ["wrong"],
    "evaluate.splits": ["test"],
    "train.betas": [0.5, 0.75],
    "train.lr_muon": 0.01,
    "evaluate.width": 0.1,
    "robot": "iiwa",
    "recipe": "act_v1",
    "tasks": ["PickCube"],
    "suite": "paper",
    "protocol": "libero",
    "levels": [1],
    "seeds": [4],
    "actor": "expert",
    "view_cameras": ["wrist"],
    "policies": ["act"],
    "augment.choose": "random",
    "policy.down_dims": [64, 128, 256],
    "policy.horizon": 16,
    "policy.n_obs_steps": 2,
    "policy.n_action_steps": 2,
    "policy.dim_model": 256,
    "policy.n_heads": 4,
    "policy.chunk_size": 120,
    "policy.vision_backbone": "resnet34",
    "policy.pretrained_backbone_weights": "ResNet18_Weights.IMAGENET1K_V1",
    "policy.backbone_norm": "batch",
    "policy.image_stats": "half",
    "policy.noise_scheduler_type": "DDIM",
    "policy.num_train_timesteps": 50,
    "policy.num_inference_steps": 5,
    "policy.backend": "sb3",
    "policy.num_minibatches": 16,
    "policy.hidden_dims": [64, 64],
    "policy.conv_channels": [8, 16],
    "policy.activation": "tanh",
    "policy.schedule": "fixed",
    "policy.max_episode_steps": 50,
    "policy.substeps": 5,
    "policy.prediction_type": "sample",
    "policy.head": "flow",
    "policy.drop_n_last_frames": 0,
    "policy.trained": "head",
    "policy.actor_dim": 256,
    "policy.critic_dim": 512,
    "policy.observation": "pixels",
    "policy.tasks": ["control/ant", "humanoid/walk"],
    "policy.model_size": 19,
    "policy.latent_dim": 256,
    "policy.simnorm_dim": 16,
    "policy.discount_max": 0.99,
    **dict.fromkeys(("policy.compile", "policy.cuda_graphs", "policy.bf16"), False),
    "view_shadows": True,
    "launcher": "slurm",
}
"""Of keys whose kind does not say it."""


def another(key: str, value: Any) -> Any:
    """A valid value of the same kind that differs from the default."""
    if key in CHOSEN:
        return CHOSEN[key]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 2
    if isinstance(value, float):
        return value / 2 or 0.25
    assert isinstance(value, str), f"Say in CHOSEN how {key} is changed."
    return "somewhere/with = , [ ${x} in it"
