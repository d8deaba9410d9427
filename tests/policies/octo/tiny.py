"""The tiny Octo of ``flax_reference.json`` as a converted folder."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save_file

from tests.policies.octo import flax_numbers as numbers

REFERENCE = json.loads(Path(__file__).with_name("flax_reference.json").read_text(encoding="utf-8"))


def config(*, repeats: bool = True, right: bool = True) -> dict[str, Any]:
    """Returns a configuration in the form of the authors', with what the converter adds."""
    encoder = {
        "name": "SmallStem16",
        "kwargs": {"features": list(numbers.SIZES["stem"]), "num_features": numbers.SIZES["stem_out"]},
    }
    sizes = numbers.SIZES
    return {
        "model_type": "octo",
        "image_sizes": dict(numbers.CAMERAS),
        "text_config": numbers.TEXT,
        "text_tokens": len(numbers.WORDS[0]),
        "window_size": 2,
        "model": {
            "observation_tokenizers": {name: {"kwargs": {"encoder": encoder}} for name in numbers.CAMERAS},
            "task_tokenizers": {"language": {}},
            "heads": {"action": {"name": "DiffusionActionHead", "kwargs": dict(numbers.HEAD)}},
            "readouts": {"action": 1},
            "token_embedding_size": sizes["width"],
            "max_horizon": sizes["horizon"],
            "transformer_kwargs": {
                "num_layers": sizes["layers"],
                "num_attention_heads": sizes["heads"],
                "mlp_dim": sizes["mlp"],
            },
            "repeat_task_tokens": repeats,
            "use_correct_attention": right,
        },
    }


def flax_tensors() -> dict[str, np.ndarray]:
    """Returns the parameters under Flax's names."""
    return {name: numbers.weight_of(name, tuple(shape)) for name, shape in REFERENCE["shapes"].items()}


def network(**flags: bool) -> Any:
    """Returns our network with the reference's weights."""
    from policies.octo.flax_names import from_flax
    from policies.octo.network import Octo
    from policies.octo.sizes import sizes_of

    model = Octo(sizes_of(config(**flags)))
    tensors = from_flax({name: torch.from_numpy(value) for name, value in flax_tensors().items()})
    missing, unexpected = model.load_state_dict(tensors, strict=False)
    assert not unexpected and set(missing) <= {"text_encoder.encoder.embed_tokens.weight"}, missing
    return model.eval()


def folder(path: Path) -> Path:
    """Writes what the converter writes, with a tokenizer of a few words."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    path.mkdir(parents=True)
    save_file(flax_tensors(), path / "flax.safetensors")
    (path / "config.json").write_text(json.dumps(config()), encoding="utf-8")
    words = ["<pad>", "</s>", "<unk>", "pick", "up", "stack", "the", "red", "green", "cube", "on"]
    table = Tokenizer(models.WordLevel({word: index for index, word in enumerate(words)}, unk_token="<unk>"))
    table.pre_tokenizer = pre_tokenizers.Whitespace()
    PreTrainedTokenizerFast(
        tokenizer_object=table, pad_token="<pad>", eos_token="</s>", unk_token="<unk>"
    ).save_pretrained(path)
    return path
