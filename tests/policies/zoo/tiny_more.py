"""Tiny backbones of further types, made from configurations: no hub, no weights of others."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.policies.zoo.tiny import bpe, paligemma, shrink_pi

QWEN = ["<|endoftext|>", "<|im_start|>", "<|im_end|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>",
        "<|video_pad|>"]  # fmt: skip
VISION = ("image_pad", "video_pad", "vision_start", "vision_end")
CHAT = (
    "{% for message in messages %}<|im_start|>{{ message['role'] }}\n"
    "{% for part in message['content'] %}{% if part['type'] == 'image' %}"
    "<|vision_start|><|image_pad|><|vision_end|>{% else %}{{ part['text'] }}{% endif %}{% endfor %}"
    "<|im_end|>\n{% endfor %}"
)
"""Qwen2.5-VL's way to write messages, without its default system message."""


def vqbet(folder: Path) -> dict[str, Any]:
    """Settings of a narrow VQ-BeT, which needs nothing else."""
    del folder
    return {
        "pretrained_backbone_weights": None, "crop_shape": None, "use_group_norm": True, "n_obs_steps": 2,
        "n_action_pred_token": 2, "action_chunk_size": 3, "n_vqvae_training_steps": 1, "vqvae_n_embed": 4,
        "vqvae_embedding_dim": 16, "vqvae_enc_hidden_dim": 16, "gpt_block_size": 32, "gpt_input_dim": 32,
        "gpt_output_dim": 32, "gpt_n_layer": 1, "gpt_n_head": 2, "gpt_hidden_dim": 32,
        "spatial_softmax_num_keypoints": 4,
    }  # fmt: skip


def qwen_tokenizer(more: Sequence[str] = (), names: Sequence[str] = ("image_token", "video_token")) -> Any:
    """A tokenizer with Qwen's special tokens.

    Args:
        more: Further special tokens.
        names: Attributes of the tokenizer that name the tokens of :data:`VISION`, in their order.
    """
    from transformers import PreTrainedTokenizerFast

    return PreTrainedTokenizerFast(
        tokenizer_object=bpe([*QWEN, *more]), pad_token="<|endoftext|>", eos_token="<|im_end|>",
        extra_special_tokens={name: f"<|{token}|>" for name, token in zip(names, VISION, strict=False)},
    )  # fmt: skip


def vision_ids(tokenizer: Any) -> dict[str, int]:
    """Returns the settings of a Qwen-VL configuration that tell which tokens stand for images."""
    image, video, start, end = (tokenizer.convert_tokens_to_ids(f"<|{name}|>") for name in VISION)
    return {
        "image_token_id": image, "video_token_id": video, "vision_start_token_id": start,
        "vision_end_token_id": end,
    }  # fmt: skip


def qwen2_5_sizes() -> dict[str, Any]:
    """Returns the settings of a Qwen2.5-VL of one narrow layer."""
    return {
        "text_config": dict(
            hidden_size=64, intermediate_size=128, num_hidden_layers=1, num_attention_heads=4,
            num_key_value_heads=2, vocab_size=512, max_position_embeddings=1024, pad_token_id=0,
            rope_parameters={"rope_type": "default", "mrope_section": [2, 3, 3], "rope_theta": 10000.0},
        ),
        "vision_config": dict(
            depth=1, hidden_size=32, intermediate_size=64, num_heads=2, out_hidden_size=64, patch_size=14,
            spatial_merge_size=2, fullatt_block_indexes=[0], window_size=112,
        ),
    }  # fmt: skip


def save_qwen2_5_processor(tokenizer: Any, folder: Path) -> Any:
    """Writes the processor of a Qwen2.5-VL and returns it."""
    from transformers.models.qwen2_5_vl.processing_qwen2_5_vl import Qwen2_5_VLProcessor
    from transformers.models.qwen2_vl.image_processing_qwen2_vl import Qwen2VLImageProcessor
    from transformers.models.qwen2_vl.video_processing_qwen2_vl import Qwen2VLVideoProcessor

    processor = Qwen2_5_VLProcessor(
        Qwen2VLImageProcessor(), tokenizer, Qwen2VLVideoProcessor(), chat_template=CHAT
    )
    processor.save_pretrained(folder)
    return processor


def eo1(folder: Path) -> dict[str, Any]:
    """A Qwen2.5-VL of one layer with its processor; returns the settings of a policy on it."""
    from transformers import Qwen2_5_VLConfig, Qwen2_5_VLForConditionalGeneration

    tokenizer = qwen_tokenizer()
    config = Qwen2_5_VLConfig(**qwen2_5_sizes(), **vision_ids(tokenizer))
    Qwen2_5_VLForConditionalGeneration(config).save_pretrained(folder)
    save_qwen2_5_processor(tokenizer, folder)
    return {
        "vlm_base": str(folder), "image_min_pixels": 28 * 28 * 4, "image_max_pixels": 28 * 28 * 4,
        "chunk_size": 4, "n_action_steps": 4, "num_denoise_steps": 2, "dtype": "float32",
    }  # fmt: skip


def evo1(folder: Path) -> dict[str, Any]:
    """An InternVL of one layer with its tokenizer; returns the settings of a policy on it."""
    from transformers import AutoModel, InternVLConfig, PreTrainedTokenizerFast

    size, width = 32, 32
    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=bpe(["<pad>", "<|im_end|>", "<IMG_CONTEXT>", "<img>", "</img>"]), pad_token="<pad>",
        eos_token="<|im_end|>",
    )  # fmt: skip
    config = InternVLConfig(
        vision_config=dict(
            hidden_size=width, intermediate_size=64, num_hidden_layers=1, num_attention_heads=2,
            image_size=[size, size], patch_size=[8, 8],
        ),
        text_config=dict(
            model_type="qwen2", hidden_size=width, intermediate_size=64, num_hidden_layers=1,
            num_attention_heads=2, num_key_value_heads=2, vocab_size=512, max_position_embeddings=512,
        ),
        image_token_id=tokenizer.convert_tokens_to_ids("<IMG_CONTEXT>"), image_seq_length=4,
    )  # fmt: skip
    AutoModel.from_config(config).save_pretrained(folder)
    tokenizer.save_pretrained(folder)
    return {
        "vlm_model_name": str(folder), "vlm_num_layers": 1, "vlm_dtype": "float32", "use_flash_attn": False,
        "image_resolution": [size, size], "max_views": 1, "max_action_dim": 9,
        "max_text_length": 128, "embed_dim": width,
        "hidden_dim": 32, "state_hidden_dim": 32, "num_heads": 2, "num_layers": 1, "chunk_size": 4,
        "n_action_steps": 4, "num_inference_timesteps": 2, "enable_gradient_checkpointing": False,
    }  # fmt: skip


FAST = """from lerobot.policies.molmoact2.molmoact2_hf_model.action_tokenizer import UniversalActionProcessor


class FastProcessor(UniversalActionProcessor):
    pass
"""
"""The code that a folder of a FAST tokenizer brings, here LeRobot's own copy of the published one."""


def fast_tokenizer(folder: Path, num_actions: int = 4) -> None:
    """A FAST action tokenizer of a few tokens, as a folder with code that runs when it is read."""
    import json

    import numpy as np
    from lerobot.policies.molmoact2.molmoact2_hf_model.action_tokenizer import UniversalActionProcessor

    chunks = np.random.default_rng(0).normal(size=(64, num_actions, 9))
    UniversalActionProcessor.fit([*chunks], scale=2, vocab_size=128).save_pretrained(folder)
    path = folder / "processor_config.json"
    auto = {
        "processor_class": "FastProcessor",
        "auto_map": {"AutoProcessor": "processing_fast.FastProcessor"},
    }
    path.write_text(json.dumps(json.loads(path.read_text()) | auto))
    (folder / "processing_fast.py").write_text(FAST)


def pi0_fast(folder: Path) -> dict[str, Any]:
    """PaliGemma's tokenizer and a FAST tokenizer; returns the settings of a policy on them."""
    paligemma(folder)
    fast_tokenizer(folder.with_name(f"{folder.name}-fast"))
    return {
        "text_tokenizer_name": str(folder), "action_tokenizer_name": f"{folder}-fast", "fast_skip_tokens": 0,
        "chunk_size": 4, "n_action_steps": 4, "tokenizer_max_length": 128, "max_action_tokens": 64,
        "max_decoding_steps": 8, "validate_action_token_prefix": False,
    }  # fmt: skip


def qwen3_vl(folder: Path) -> None:
    """Writes a Qwen3-VL of one narrow layer with its processor."""
    from transformers import Qwen3VLConfig, Qwen3VLForConditionalGeneration
    from transformers.models.qwen2_vl.image_processing_qwen2_vl import Qwen2VLImageProcessor
    from transformers.models.qwen3_vl.processing_qwen3_vl import Qwen3VLProcessor
    from transformers.models.qwen3_vl.video_processing_qwen3_vl import Qwen3VLVideoProcessor

    tokenizer = qwen_tokenizer(names=("image_token", "video_token", "vision_bos_token", "vision_eos_token"))
    config = Qwen3VLConfig(
        text_config=dict(
            hidden_size=32, intermediate_size=64, num_hidden_layers=1, num_attention_heads=2,
            num_key_value_heads=1, head_dim=16, vocab_size=512, max_position_embeddings=512, pad_token_id=0,
            rope_parameters={
                "rope_type": "default", "mrope_section": [4, 2, 2], "rope_theta": 1e4,
                "mrope_interleaved": True,
            },
        ),
        vision_config=dict(
            depth=1, hidden_size=32, intermediate_size=64, num_heads=2, out_hidden_size=32, patch_size=16,
            spatial_merge_size=2, temporal_patch_size=2, num_position_embeddings=16,
            deepstack_visual_indexes=[0],
        ),
        **vision_ids(tokenizer),
    )  # fmt: skip
    Qwen3VLForConditionalGeneration(config).save_pretrained(folder)
    size = {"shortest_edge": 32 * 32, "longest_edge": 32 * 32}
    shape = {"patch_size": 16, "merge_size": 2, "temporal_patch_size": 2, "size": size}
    Qwen3VLProcessor(
        Qwen2VLImageProcessor(**shape), tokenizer, Qwen3VLVideoProcessor(**shape), chat_template=CHAT
    ).save_pretrained(folder)


def vla_jepa(folder: Path) -> dict[str, Any]:
    """A Qwen3-VL and a V-JEPA 2 of one layer, with processors; returns the settings of a policy on them."""
    from transformers import VJEPA2Config, VJEPA2Model
    from transformers.models.vjepa2.video_processing_vjepa2 import VJEPA2VideoProcessor

    qwen3_vl(folder)
    encoder = folder.with_name(f"{folder.name}-jepa")
    VJEPA2Model(
        VJEPA2Config(
            patch_size=16, crop_size=32, frames_per_clip=4, tubelet_size=2, hidden_size=32,
            num_hidden_layers=1, num_attention_heads=2, mlp_ratio=2.0, pred_hidden_size=32,
            pred_num_hidden_layers=1, pred_num_attention_heads=2, pred_num_mask_tokens=1, pred_mlp_ratio=2.0,
        )
    ).save_pretrained(encoder)  # fmt: skip
    VJEPA2VideoProcessor(size={"shortest_edge": 32}, crop_size={"height": 32, "width": 32}).save_pretrained(
        encoder
    )
    return {
        "qwen_model_name": str(folder), "jepa_encoder_name": str(encoder), "torch_dtype": "float32",
        "chunk_size": 4, "n_action_steps": 4, "num_video_frames": 4, "num_inference_timesteps": 2,
        "action_model_type": "DiT-test", "action_hidden_size": 16, "action_num_layers": 2,
        "action_dropout": 0.0, "num_action_tokens_per_timestep": 2,
        "num_embodied_action_tokens_per_instruction": 4, "predictor_depth": 1, "predictor_num_heads": 2,
        "repeated_diffusion_steps": 2,
        "binarize_gripper_action": False, "pre_snap_gripper_action": False,
    }  # fmt: skip


def fastwam(folder: Path) -> dict[str, Any]:
    """Wan's VAE and UMT5 of one narrow layer each; returns the settings of a policy on them."""
    from diffusers import AutoencoderKLWan
    from transformers import PreTrainedTokenizerFast, UMT5Config, UMT5EncoderModel

    PreTrainedTokenizerFast(
        tokenizer_object=bpe(["<pad>", "</s>"]), pad_token="<pad>", eos_token="</s>"
    ).save_pretrained(folder)  # fmt: skip
    UMT5EncoderModel(
        UMT5Config(vocab_size=320, d_model=32, d_kv=16, d_ff=64, num_layers=1, num_heads=2)
    ).save_pretrained(folder / "text_encoder")  # fmt: skip
    AutoencoderKLWan(
        base_dim=4, decoder_base_dim=4, z_dim=48, num_res_blocks=1, in_channels=12, out_channels=12,
        patch_size=2, is_residual=True, scale_factor_spatial=16,
        latents_mean=[0.0] * 48, latents_std=[1.0] * 48,
    ).save_pretrained(folder / "vae")  # fmt: skip
    transformer = dict(
        hidden_dim=32, ffn_dim=64, freq_dim=32, text_dim=32, num_heads=2, attn_head_dim=16, num_layers=1,
        eps=1e-6, action_dim=9,
    )  # fmt: skip
    video = dict(
        patch_size=[1, 2, 2], in_dim=48, out_dim=48, seperated_timestep=True, action_conditioned=False,
        video_attention_mask_mode="first_frame_causal", action_group_causal_mask_mode="group_diagonal",
    )  # fmt: skip
    return {
        "text_encoder_model_id": str(folder), "tokenizer_model_id": str(folder), "tokenizer_max_len": 128,
        "base_model_id": None, "action_dim": 9, "proprio_dim": 9, "image_size": [32, 32],
        "num_video_frames": 5, "action_video_freq_ratio": 1, "action_horizon": 4, "n_action_steps": 4,
        "num_inference_steps": 2, "torch_dtype": "float32", "video_dit_config": transformer | video,
        "action_dit_config": transformer,
    }  # fmt: skip


def molmoact2(folder: Path) -> dict[str, Any]:
    """A MolmoAct2 of one narrow layer with its tokenizer; returns the settings of a policy on it."""
    import json

    from lerobot.policies.molmoact2.molmoact2_hf_model import configuration_molmoact2 as configuration
    from lerobot.policies.molmoact2.molmoact2_hf_model.modeling_molmoact2 import (
        MolmoAct2ForConditionalGeneration,
    )
    from lerobot.policies.molmoact2.molmoact2_hf_model.processing_molmoact2 import IMAGE_TOKENS
    from transformers import PreTrainedTokenizerFast

    marks = [
        f"<{name}_{end}>" for name in ("action", "state", "setup", "control") for end in ("start", "end")
    ]
    bins = [f"<state_{each}>" for each in range(8)]
    tokenizer = bpe(
        ["<|endoftext|>", "<|im_start|>", "<|im_end|>", "<action_output>", *IMAGE_TOKENS, *marks, *bins]
    )
    PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, pad_token="<|endoftext|>", bos_token="<|endoftext|>",
        eos_token="<|endoftext|>",
    ).save_pretrained(folder)  # fmt: skip
    ids = {token: tokenizer.token_to_id(token) for token in [*IMAGE_TOKENS, *marks, "<action_output>"]}
    narrow = {"hidden_size": 32, "num_attention_heads": 2, "head_dim": 16, "intermediate_size": 64}
    config = configuration.MolmoAct2Config(
        vit_config=narrow | dict(
            num_hidden_layers=2, num_key_value_heads=2, image_default_input_size=[28, 28], image_num_pos=4,
        ),
        adapter_config=narrow | dict(vit_layers=[-1, -2], num_key_value_heads=2, text_hidden_size=32),
        text_config=narrow | dict(
            num_hidden_layers=1, num_key_value_heads=1, vocab_size=512, additional_vocab_size=8,
        ),
        action_expert_config=dict(
            hidden_size=32, num_layers=1, num_heads=2, ffn_multiple_of=16, timestep_embed_dim=32,
        ),
        image_start_token_id=ids["<im_start>"], image_end_token_id=ids["<im_end>"],
        low_res_image_start_token_id=ids["<low_res_im_start>"], image_low_res_id=ids["<im_low>"],
        image_patch_id=ids["<im_patch>"], image_col_id=ids["<im_col>"],
        frame_start_token_id=ids["<frame_start>"], frame_end_token_id=ids["<frame_end>"],
        action_output_token_id=ids["<action_output>"], action_start_token_id=ids["<action_start>"],
        action_end_token_id=ids["<action_end>"],
    )  # fmt: skip
    MolmoAct2ForConditionalGeneration(config).save_pretrained(folder)
    images = {"size": {"height": 28, "width": 28}, "crop_mode": "resize"}
    (folder / "processor_config.json").write_text(json.dumps({"image_processor": images}))
    return {
        "checkpoint_path": str(folder), "action_mode": "continuous", "inference_action_mode": "continuous",
        "chunk_size": 4, "n_action_steps": 4, "num_state_tokens": 8, "max_sequence_length": 512,
        "num_flow_timesteps": 2, "num_inference_steps": 2, "model_dtype": "float32",
        "enable_inference_cuda_graph": False,
    }  # fmt: skip


def shrink_fastwam(monkeypatch: Any, folder: Path) -> None:
    """Gives FastWAM a VAE of one's own; LeRobot's code names the one that it always takes."""
    from lerobot.policies.fastwam.wan import components

    monkeypatch.setattr(components, "WAN22_DIFFUSERS_MODEL_ID", str(folder))


def shrink_pi0_fast(monkeypatch: Any, folder: Path) -> None:
    """Makes π0-FAST narrow."""
    from transformers import AutoTokenizer

    words = len(AutoTokenizer.from_pretrained(folder))  # each output is a word of the tokenizer
    shrink_pi(monkeypatch, "lerobot.policies.pi0_fast.modeling_pi0_fast", words)


FIXED_IN_CODE = {"pi0_fast": shrink_pi0_fast, "fastwam": shrink_fastwam}
"""What replaces sizes and names that no setting of LeRobot reaches, by type."""
