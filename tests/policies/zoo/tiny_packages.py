"""Tiny versions of the types that need further packages of the extra: WALL-OSS (wall_x) and GR00T."""

from pathlib import Path
from typing import Any

from tests.policies.zoo.tiny_more import (
    qwen2_5_sizes,
    qwen3_vl,
    qwen_tokenizer,
    save_qwen2_5_processor,
    vision_ids,
)

WALL_X_WIDTH = 20
"""Numbers that WALL-OSS pads states and actions to, as its published configuration has it."""


def wall_x(folder: Path) -> dict[str, Any]:
    """A WALL-OSS of one narrow layer with its processor; returns the settings of a policy on it."""
    from lerobot.policies.wall_x.modeling_wall_x import Qwen2_5_VLMoEForAction
    from lerobot.policies.wall_x.qwen_model import Qwen2_5_VLConfig
    from safetensors.torch import save_file

    tokenizer = qwen_tokenizer(["<|action|>", "<|propri|>", "<|action_fast|>"])
    processor = save_qwen2_5_processor(tokenizer, folder)
    sizes = qwen2_5_sizes()
    width = sizes["text_config"]["hidden_size"]
    expert = {"hidden_size": width, "intermediate_size": 64, "hidden_act": "silu"}
    sizes["text_config"] |= {
        "num_experts": 2, "experts": [expert, expert], "dim_inputs": [width, width], "mlp_moe": True,
        "dof_config": {"joints": WALL_X_WIDTH},
    }  # fmt: skip
    further: dict[str, Any] = {"agent_pos_config": {"joints": WALL_X_WIDTH}}
    config = Qwen2_5_VLConfig(**sizes, **vision_ids(tokenizer), **further)
    config._attn_implementation = "eager"  # what LeRobot's code asks for
    config.save_pretrained(folder)
    model = Qwen2_5_VLMoEForAction(config, processor=processor)
    model.resize_token_embeddings(len(tokenizer))
    save_file({key: value.clone() for key, value in model.state_dict().items()}, folder / "model.safetensors")
    return {"pretrained_name_or_path": str(folder), "chunk_size": 8, "n_action_steps": 8}


def groot(folder: Path) -> dict[str, Any]:
    """A GR00T N1.7 of four blocks on a Qwen3-VL of one layer; returns the settings of a policy on it."""
    from lerobot.policies.groot.groot_n1_7 import GR00TN17, GR00TN17Config

    qwen3_vl(folder)
    width, steps = 32, 8
    attention = {"num_attention_heads": 2, "attention_head_dim": width // 2, "positional_embeddings": None}
    config = GR00TN17Config(
        model_name=str(folder), select_layer=1, backbone_embedding_dim=width, hidden_size=width,
        input_embedding_dim=width, action_horizon=steps, max_seq_len=steps,
        max_num_embodiments=11,  # 10 is the number of a new embodiment
        diffusion_model_cfg=attention | dict(
            num_layers=4, norm_type="ada_norm", output_dim=width, interleave_self_attention=True,
        ),
        vl_self_attention_cfg=attention | dict(num_layers=1),
    )  # fmt: skip
    base = folder.with_name(f"{folder.name}-base")
    GR00TN17(config, load_backbone_weights=False).save_pretrained(base)
    return {
        "base_model_path": str(base), "chunk_size": steps, "n_action_steps": steps,
        "num_inference_timesteps": 2,
    }  # fmt: skip


def shrink_groot(monkeypatch: Any, folder: Path) -> None:
    """Gives GR00T a tokenizer of one's own; LeRobot's code names the one that it always takes."""
    from lerobot.policies.groot import processor_groot

    monkeypatch.setattr(processor_groot, "GROOT_N1_7_BACKBONE_MODEL", str(folder))


FIXED_IN_CODE = {"groot": shrink_groot}
"""What replaces names that no setting of LeRobot reaches, by type."""

TARGETS = {"wall_x": ["q_proj", "v_proj"], "groot": ["to_q", "to_v"]}
"""Layers with adapters: LeRobot names none for these types."""
