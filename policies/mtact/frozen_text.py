"""Sentence vectors of a frozen BERT-like model, which travels inside a checkpoint.

The whole model is tensors: its weights, and the bytes of its configuration and of its tokenizer. So LeRobot
keeps it beside the processors, as it keeps statistics, and a folder that moves still loads.
"""

import json
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from envs.core.errors import MissingExtraError, PolicyError
from envs.core.extras import install_command
from policies.mtact.config import MtActConfig

_CONFIG, _TOKENIZER, _WEIGHTS = "config", "tokenizer", "weights."
_MAX_TOKENS = 128


class FrozenTextEncoder:
    """The mean of a BERT-like model's last hidden states, of length 1, as sentence-transformers computes it.

    The vector of each wording is computed once, alone, on the CPU.

    Args:
        config: The model's configuration, with its ``model_type``.
        tokenizer: The content of its ``tokenizer.json``.
        weights: Its tensors.

    Raises:
        MissingExtraError: if transformers is not installed.
        PolicyError: if the parts do not fit each other.
    """

    def __init__(self, config: Mapping[str, Any], tokenizer: str, weights: Mapping[str, Tensor]) -> None:
        transformers = _transformers()
        from tokenizers import Tokenizer  # pyright: ignore[reportMissingImports]

        self._parts = dict(config), tokenizer
        values = {key: value for key, value in config.items() if key != "model_type"}
        try:
            own = transformers.AutoConfig.for_model(config["model_type"], **values)
            self._model = transformers.AutoModel.from_config(own).float().eval().requires_grad_(False)
            self._model.load_state_dict(dict(weights))
            self._tokenizer: Any = Tokenizer.from_str(tokenizer)
        except (KeyError, ValueError, TypeError, RuntimeError) as error:
            raise PolicyError(f"The text encoder cannot be made: {error}") from error
        positions = int(getattr(own, "max_position_embeddings", _MAX_TOKENS))
        self._tokenizer.no_padding()
        self._tokenizer.enable_truncation(min(_MAX_TOKENS, positions))
        self.size = int(own.hidden_size)
        self._known: dict[str, Tensor] = {}

    @classmethod
    def from_folder(cls, folder: str | Path) -> "FrozenTextEncoder":
        """Reads a model as transformers saves it: configuration, weights and a fast tokenizer.

        Raises:
            MissingExtraError: if transformers is not installed.
            PolicyError: if the folder holds no such model.
        """
        transformers = _transformers()
        _check_folder(Path(folder))
        try:
            model = transformers.AutoModel.from_pretrained(
                folder, local_files_only=True, dtype=torch.float32, use_safetensors=True
            )
            tokenizer = transformers.AutoTokenizer.from_pretrained(folder, local_files_only=True)
            text = tokenizer.backend_tokenizer.to_str()
        except (OSError, ValueError, KeyError, ImportError, AttributeError) as error:
            reason = " ".join(str(error).split())
            raise PolicyError(
                f"policy.text_encoder={folder} cannot be read as a BERT-like model: {reason}"
            ) from error
        return cls(json.loads(model.config.to_json_string(use_diff=False)), text, model.state_dict())

    def vectors(self, texts: Sequence[str]) -> Tensor:
        """Returns the vectors (n, size) of n texts, float32."""
        for text in texts:
            if text not in self._known:
                self._known[text] = self._vector(text)
        return torch.stack([self._known[text] for text in texts])

    @torch.no_grad()
    def _vector(self, text: str) -> Tensor:
        tokens = torch.tensor([self._tokenizer.encode(text).ids or [0]])
        states = self._model(input_ids=tokens, attention_mask=torch.ones_like(tokens)).last_hidden_state
        return functional.normalize(states[0].mean(0), dim=0)

    def state_dict(self) -> dict[str, Tensor]:
        """Returns the whole encoder as tensors."""
        config, tokenizer = self._parts
        parts = {_CONFIG: _bytes(json.dumps(config)), _TOKENIZER: _bytes(tokenizer)}
        return parts | {
            f"{_WEIGHTS}{name}": value.contiguous().clone()
            for name, value in self._model.state_dict().items()
        }

    @classmethod
    def from_state_dict(cls, state: Mapping[str, Tensor]) -> "FrozenTextEncoder":
        """Makes the encoder that :meth:`state_dict` described.

        Raises:
            PolicyError: if a part is absent or damaged.
        """
        weights = {
            name.removeprefix(_WEIGHTS): value for name, value in state.items() if name.startswith(_WEIGHTS)
        }
        try:
            config, tokenizer = (bytes(state[key].tolist()).decode() for key in (_CONFIG, _TOKENIZER))
            return cls(json.loads(config), tokenizer, weights)
        except (KeyError, ValueError) as error:
            raise PolicyError(f"The text encoder of the checkpoint is damaged: {error!r}.") from error


def check_mtact(config: MtActConfig, features: Mapping[str, Any]) -> None:
    """Checks the text encoder of ``policy=mtact``, before demonstrations are collected.

    Raises:
        MissingExtraError: if transformers is not installed.
        PolicyError: if its folder holds no model.
    """
    del features
    if config.text_encoder != "scratch":
        width_of(config.text_encoder)
        if find_spec("transformers") is None:
            _transformers()


def width_of(folder: str | Path) -> int:
    """Returns the width of the vectors of the model in a folder.

    Raises:
        PolicyError: if the folder does not say.
    """
    path = _check_folder(Path(folder)) / "config.json"
    try:
        return int(json.loads(path.read_text(encoding="utf-8"))["hidden_size"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PolicyError(
            f"policy.text_encoder={folder}: its config.json names no hidden_size, as that of a BERT-like "
            f"model does ({error!r})."
        ) from error


def _check_folder(folder: Path) -> Path:
    if not (folder / "config.json").is_file():
        raise PolicyError(
            f"policy.text_encoder={folder} is no folder of a model (config.json is missing). Give scratch, "
            "or the folder of a BERT-like model as transformers saves it. A run that goes on reads it, too, "
            "although its checkpoints hold a copy: put the folder back where it was."
        )
    return folder


def _bytes(text: str) -> Tensor:
    return torch.from_numpy(np.frombuffer(text.encode(), np.uint8).copy())


def _transformers() -> Any:
    try:
        import transformers
    except ImportError as error:
        raise MissingExtraError(
            f"policy.text_encoder=<folder> needs transformers: {install_command('language')}. "
            "policy.text_encoder=scratch needs nothing."
        ) from error
    return transformers
