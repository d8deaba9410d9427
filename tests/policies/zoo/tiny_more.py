"""Tiny backbones of further types, made from configurations: no hub, no weights of others."""

from pathlib import Path
from typing import Any

from tests.policies.zoo.tiny import bpe

QWEN = ["<|endoftext|>", "<|im_start|>", "<|im_end|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>",
        "<|video_pad|>"]  # fmt: skip
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


def eo1(folder: Path) -> dict[str, Any]:
    """A Qwen2.5-VL of one layer with its processor; returns the settings of a policy on it."""
    from transformers import PreTrainedTokenizerFast, Qwen2_5_VLConfig, Qwen2_5_VLForConditionalGeneration
    from transformers.models.qwen2_5_vl.processing_qwen2_5_vl import Qwen2_5_VLProcessor
    from transformers.models.qwen2_vl.image_processing_qwen2_vl import Qwen2VLImageProcessor
    from transformers.models.qwen2_vl.video_processing_qwen2_vl import Qwen2VLVideoProcessor

    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=bpe(QWEN), pad_token="<|endoftext|>", eos_token="<|im_end|>",
        extra_special_tokens={"image_token": "<|image_pad|>", "video_token": "<|video_pad|>"},
    )  # fmt: skip
    ids = {name: tokenizer.convert_tokens_to_ids(f"<|{name}|>") for name in
           ("image_pad", "video_pad", "vision_start", "vision_end")}  # fmt: skip
    config = Qwen2_5_VLConfig(
        text_config=dict(
            hidden_size=64, intermediate_size=128, num_hidden_layers=1, num_attention_heads=4,
            num_key_value_heads=2, vocab_size=512, max_position_embeddings=1024, pad_token_id=0,
            rope_parameters={"rope_type": "default", "mrope_section": [2, 3, 3], "rope_theta": 10000.0},
        ),
        vision_config=dict(
            depth=1, hidden_size=32, intermediate_size=64, num_heads=2, out_hidden_size=64, patch_size=14,
            spatial_merge_size=2, fullatt_block_indexes=[0], window_size=112,
        ),
        image_token_id=ids["image_pad"], video_token_id=ids["video_pad"],
        vision_start_token_id=ids["vision_start"], vision_end_token_id=ids["vision_end"],
    )  # fmt: skip
    Qwen2_5_VLForConditionalGeneration(config).save_pretrained(folder)
    Qwen2_5_VLProcessor(
        Qwen2VLImageProcessor(), tokenizer, Qwen2VLVideoProcessor(), chat_template=CHAT
    ).save_pretrained(folder)
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
