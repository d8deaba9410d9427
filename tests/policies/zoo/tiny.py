"""Tiny backbones and tokenizers, made from configurations: no hub, no weights of others."""

from pathlib import Path
from typing import Any

from tests.policies.examples import SIZE

WORDS = ("pick up the red cube", "push the blue block to the left", "open the drawer", "close the box")
SPECIALS = {
    "multi_task_dit": ["<|pad|>", "<|startoftext|>", "<|endoftext|>"],
    "xvla": ["<s>", "<pad>", "</s>", "<unk>", "<image>"],
    "paligemma": ["<pad>", "<eos>", "<bos>", "<unk>"],
    "llama": ["<unk>", "<s>", "</s>"],
}
VQBET = {
    "n_obs_steps": 2, "n_action_pred_token": 2, "action_chunk_size": 3, "crop_shape": [SIZE, SIZE],
    "pretrained_backbone_weights": None, "use_group_norm": True, "spatial_softmax_num_keypoints": 4,
    "vqvae_embedding_dim": 16, "vqvae_enc_hidden_dim": 16, "gpt_block_size": 20, "gpt_input_dim": 16,
    "gpt_output_dim": 16, "gpt_n_layer": 1, "gpt_n_head": 2, "gpt_hidden_dim": 16,
    "n_vqvae_training_steps": 1, "vision_backbone": "resnet18",
}  # fmt: skip
"""Settings of VQ-BeT, which needs no extra."""


def bpe(specials: list[str], size: int = 320) -> Any:
    """A byte-level tokenizer, which has every word."""
    from tokenizers import Tokenizer, decoders, models, normalizers, pre_tokenizers, trainers

    tokenizer = Tokenizer(models.BPE())
    tokenizer.normalizer = normalizers.Lowercase()
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    alphabet = pre_tokenizers.ByteLevel.alphabet()
    tokenizer.train_from_iterator(
        WORDS, trainers.BpeTrainer(vocab_size=size, special_tokens=specials, initial_alphabet=alphabet)
    )
    return tokenizer


def smolvla(folder: Path) -> dict[str, Any]:
    """A SmolVLM of two text layers and its processor; returns the settings of a policy on it."""
    from roboverse_learn.speed.vla import TINY
    from roboverse_learn.training.imitation.small_backbone import write_smolvlm

    write_smolvlm(folder, TINY, list(WORDS), weights=True)
    return {
        "vlm_model_name": str(folder), "load_vlm_weights": True, "num_vlm_layers": 2, "chunk_size": 8,
        "n_action_steps": 8, "num_steps": 2, "resize_imgs_with_padding": [64, 64],
        "freeze_vision_encoder": False, "train_expert_only": False,
    }  # fmt: skip


def multi_task_dit(folder: Path) -> dict[str, Any]:
    """A CLIP of two layers; returns the settings of a policy on it."""
    from tokenizers.processors import TemplateProcessing
    from transformers import CLIPConfig, CLIPModel, PreTrainedTokenizerFast

    folder = folder.with_name(f"{folder.name}-clip")
    tokenizer = bpe(SPECIALS["multi_task_dit"])
    start, end = tokenizer.token_to_id("<|startoftext|>"), tokenizer.token_to_id("<|endoftext|>")
    tokenizer.post_processor = TemplateProcessing(
        single="<|startoftext|> $A <|endoftext|>",
        special_tokens=[("<|startoftext|>", start), ("<|endoftext|>", end)],
    )
    fast = PreTrainedTokenizerFast(
        tokenizer_object=tokenizer,
        pad_token="<|pad|>",
        bos_token="<|startoftext|>",
        eos_token="<|endoftext|>",
    )
    shared = dict(hidden_size=32, intermediate_size=64, num_hidden_layers=2, num_attention_heads=2)
    config = CLIPConfig(
        text_config=dict(
            **shared, vocab_size=len(fast), max_position_embeddings=32, bos_token_id=start, eos_token_id=end,
            pad_token_id=0,
        ),
        vision_config=dict(**shared, image_size=64, patch_size=16),
        projection_dim=32,
    )  # fmt: skip
    CLIPModel(config).save_pretrained(folder)
    fast.save_pretrained(folder)
    return {
        "vision_encoder_name": str(folder), "text_encoder_name": str(folder), "tokenizer_max_length": 32,
        "horizon": 8, "n_action_steps": 6, "hidden_dim": 32, "num_layers": 1, "num_heads": 2,
        "timestep_embed_dim": 32, "num_train_timesteps": 10, "num_inference_steps": 2,
        "image_resize_shape": [64, 64], "image_crop_shape": [64, 64],
    }  # fmt: skip


def xvla(folder: Path) -> dict[str, Any]:
    """A Florence-2 of four narrow stages, which comes from a dictionary; only the tokenizer is a folder."""
    from transformers import PreTrainedTokenizerFast

    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=bpe(SPECIALS["xvla"]), pad_token="<pad>", bos_token="<s>", eos_token="</s>",
        unk_token="<unk>",
    )  # fmt: skip
    tokenizer.save_pretrained(folder)
    special = dict(pad_token_id=1, bos_token_id=0, eos_token_id=2)
    florence = dict(
        vision_config=dict(
            model_type="florence_vision", embed_dim=[16, 32, 64, 64], depths=[1] * 4, num_heads=[2, 2, 4, 4],
            num_groups=[2, 2, 4, 4], patch_size=[7, 3, 3, 3], patch_stride=[4, 2, 2, 2],
            patch_padding=[3, 1, 1, 1], patch_prenorm=[False, True, True, True], window_size=4,
            projection_dim=64,
        ),
        text_config=dict(
            model_type="bart", vocab_size=len(tokenizer), d_model=64, encoder_layers=1, decoder_layers=1,
            encoder_attention_heads=4, decoder_attention_heads=4, encoder_ffn_dim=128, decoder_ffn_dim=128,
            max_position_embeddings=256, **special,
        ),
        **special, image_token_id=4, is_encoder_decoder=True,
    )  # fmt: skip
    return {
        "florence_config": florence, "tokenizer_name": str(folder), "tokenizer_max_length": 32,
        "action_mode": "auto", "max_action_dim": 20, "hidden_size": 64, "depth": 1, "num_heads": 4,
        "num_domains": 2, "len_soft_prompts": 4, "max_len_seq": 256, "resize_imgs_with_padding": [64, 64],
        "chunk_size": 8, "n_action_steps": 8, "num_denoising_steps": 2,
        "normalization_mapping": {"VISUAL": "IDENTITY", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"},
    }  # fmt: skip


def paligemma(folder: Path) -> dict[str, Any]:
    """A tokenizer with PaliGemma's special tokens; returns the settings of π0 and π0.5."""
    from transformers import PreTrainedTokenizerFast

    PreTrainedTokenizerFast(
        tokenizer_object=bpe(SPECIALS["paligemma"]), pad_token="<pad>", bos_token="<bos>", eos_token="<eos>",
        unk_token="<unk>",
    ).save_pretrained(folder)  # fmt: skip
    return {"chunk_size": 8, "n_action_steps": 8, "num_inference_steps": 2}


def shrink_pi(monkeypatch: Any, module: str, words: int = 512) -> None:
    """Makes one of π0's family narrow, whose sizes are fixed in LeRobot's code at about 3 B parameters."""
    import importlib

    pi = importlib.import_module(module)
    vision_language = pi.PaliGemmaForConditionalGenerationWithPiGemma
    expert = getattr(pi, "PiGemmaForCausalLM", None)  # π0-FAST has no expert
    narrow = pi.GemmaConfig(width=64, depth=1, mlp_dim=128, num_heads=8, num_kv_heads=1, head_dim=16)

    def make(config: Any) -> Any:
        text, vision = config.text_config, config.vision_config
        text.vocab_size, config.image_token_index = words, words - 1
        vision.hidden_size, vision.intermediate_size, vision.num_hidden_layers = 32, 64, 1
        vision.num_attention_heads, vision.projection_dim = 2, text.hidden_size
        config.projection_dim = text.hidden_size
        return vision_language(config)

    def make_expert(config: Any) -> Any:
        config.vocab_size = 8
        return expert(config)

    monkeypatch.setattr(pi, "get_gemma_config", lambda _: narrow)
    monkeypatch.setattr(pi, "PaliGemmaForConditionalGenerationWithPiGemma", make)
    if expert is not None:
        monkeypatch.setattr(pi, "PiGemmaForCausalLM", make_expert)


def openvla(folder: Path) -> None:
    """A copy of OpenVLA with two narrow vision transformers and a Llama of two layers, with its tokenizer."""
    import json

    import torch
    from safetensors.torch import save_file
    from transformers import PreTrainedTokenizerFast

    from policies.openvla.network import OpenVla, from_timm

    tokenizer = PreTrainedTokenizerFast(
        tokenizer_object=bpe(SPECIALS["llama"]), bos_token="<s>", eos_token="</s>", unk_token="<unk>"
    )
    tokenizer.add_special_tokens({"pad_token": "<pad>"})
    words = len(tokenizer)
    config = {
        "model_type": "openvla", "timm_model_ids": ["vit_tiny_patch16_224"] * 2, "image_sizes": [32, 32],
        "n_action_bins": 256, "pad_to_multiple_of": 64, "norm_stats": {},
        "text_config": {
            "model_type": "llama", "hidden_size": 64, "intermediate_size": 128, "num_hidden_layers": 2,
            "num_attention_heads": 4, "num_key_value_heads": 4, "vocab_size": words + 256 + 64,
            "max_position_embeddings": 512, "bos_token_id": 1, "eos_token_id": 2, "pad_token_id": words - 1,
        },
    }  # fmt: skip
    torch.manual_seed(0)
    model = OpenVla(config)
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps(config))
    tensors = {key: value.contiguous() for key, value in from_timm(model.state_dict()).items()}
    save_file(tensors, folder / "model.safetensors")
    tokenizer.save_pretrained(folder)
