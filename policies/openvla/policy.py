"""OpenVLA behind the interface of every policy.

Shapes: n environments or samples, A numbers of an action, L tokens, S pixels a side.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, override

import numpy as np
import torch
from lerobot.configs import FeatureType
from torch import Tensor, nn

from envs.core.errors import PolicyError
from envs.core.observation_keys import IMAGE_PREFIX
from policies import checkpoint
from policies.base import Observation
from policies.imitation import ACTION
from policies.lerobot_policy import policy_features
from policies.objective import Loss, Objective, Preprocess
from policies.openvla.config import OpenVlaConfig
from policies.openvla.network import OpenVla, from_timm, pixels_of, to_timm
from policies.openvla.tokens import ActionScale, ActionTokens, norm_stats, padded, prompt_tokens
from policies.zoo import adapters
from policies.zoo.config import full_rename_map
from policies.zoo.fine_tuned import FineTunedPolicy
from policies.zoo.source import base_name, local_folder
from policies.zoo.weights import load_tensors, read_tensors

logger = logging.getLogger(__name__)

_IGNORED = -100  # what cross entropy leaves out
_TOKENIZER = ("tokenizer.json", "tokenizer.model")


class OpenVlaPolicy(FineTunedPolicy):
    """OpenVLA, arXiv:2406.09246: one action per look at one image, each number a token."""

    name = "openvla"

    def __init__(self, model: Any, tokenizer: Any, image_key: str, unnorm_key: str) -> None:
        self.model, self.tokenizer, self.unnorm_key = model, tokenizer, unnorm_key
        self._image_key, self._image_shape = image_key, (3, self.size, self.size)
        settings = self.network.settings
        text = self.network.language_model.config
        vocabulary = text.vocab_size - int(settings.get("pad_to_multiple_of", 64))
        self.tokens = ActionTokens(vocabulary, int(settings.get("n_action_bins", 256)))
        self.scale = ActionScale(settings["norm_stats"][unnorm_key]["action"])
        self.batch_invariant = self.device.type == "cpu"

    @classmethod
    @override
    def create(
        cls,
        features: Mapping[str, Any],
        stats: Mapping[str, Mapping[str, Any]],
        config: OpenVlaConfig,
        device: str,
    ) -> Self:
        if not config.path:
            raise PolicyError(
                "policy=openvla fine-tunes a published checkpoint: give policy.path=<folder or hub name>, "
                "as in "
                "policy.path=openvla/openvla-7b. It has 15 GB, which are checked against disk and memory "
                "first."
            )
        inputs, _ = policy_features(features)
        cameras = [key for key, feature in inputs.items() if feature.type is FeatureType.VISUAL]
        image_key = IMAGE_PREFIX + config.camera if config.camera else next(iter(cameras), "")
        if image_key not in cameras:
            names = ", ".join(key.removeprefix(IMAGE_PREFIX) for key in cameras) or "none"
            raise PolicyError(
                f"policy.camera={config.camera} is no camera of the dataset, which has {names}."
            )
        folder = local_folder(config.path)
        model = _read_model(folder)
        model.settings["norm_stats"] = {
            **model.settings.get("norm_stats", {}), config.unnorm_key: norm_stats(stats)
        }  # fmt: skip
        if config.peft.method_type:
            base = base_name(config.path)
            model = adapters.wrap_own(model, config.peft, base, what="OpenVLA", without=["lm_head"])
        return cls(model.to(device).eval(), _read_tokenizer(folder), image_key, config.unnorm_key)

    # --- what it takes and gives ----------------------------------------------------------------

    @property
    def size(self) -> int:
        """Pixels a side of what the network sees."""
        return int(self.network.settings["image_sizes"][0])

    @property
    @override
    def device(self) -> torch.device:
        return next(self.model.parameters()).device

    @property
    @override
    def n_obs_steps(self) -> int:
        return 1

    @property
    @override
    def n_action_steps(self) -> int:
        return 1

    @property
    @override
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        return {self._image_key: self._image_shape, ACTION: (len(self.scale.low),)}

    @property
    @override
    def image_keys(self) -> Sequence[str]:
        return [self._image_key]

    def see(self, cameras: Sequence[str], rename_map: Mapping[str, str]) -> None:
        """Chooses the camera that it sees: the one that ``rename_map`` names, or its own, or the first."""
        chosen = next(iter(full_rename_map(dict(rename_map))), self._image_key)
        keys = [IMAGE_PREFIX + name for name in cameras]
        if not chosen and keys:
            chosen = keys[0]
        if chosen not in keys:
            raise PolicyError(
                f"OpenVLA sees the camera {chosen.removeprefix(IMAGE_PREFIX)}, and the task has "
                f"{', '.join(cameras) or 'none'}. Name the one to see, as in "
                f"'rename_map={{{cameras[0]}:image}}'."
            )
        self._image_key = chosen

    # --- acting ---------------------------------------------------------------------------------

    @override
    def _to_tensors(self, observation: Observation) -> dict[str, Any]:
        image = observation.get(self._image_key)
        if image is not None:  # of any size, for it is resized
            height, width = np.asarray(image).shape[1:3]
            self._image_shape = (3, int(height), int(width))
        return super()._to_tensors(observation)

    @override
    def preprocess(self, batch: Mapping[str, Any]) -> dict[str, Any]:
        images = batch[self._image_key].to(self.device, non_blocking=True)
        images = images.float() / 255.0 if images.dtype is torch.uint8 else images.float()
        fused = self.network.vision_backbone.fused_featurizer is not None
        out = {
            "pixels": pixels_of(images, self.size, fused=fused),
            "prompts": prompt_tokens(self.tokenizer, self.words(batch, len(images))),
        }
        if ACTION in batch:
            actions = batch[ACTION].to(self.device)
            out[ACTION] = actions[:, 0] if actions.ndim == 3 else actions
        return out

    @override
    def predict(self, batch: dict[str, Any], generators: Sequence[torch.Generator] | None) -> Tensor:
        del generators  # the likeliest tokens; nothing is drawn
        prompts, count = batch["prompts"], len(self.scale.low)
        answers = torch.zeros(len(prompts), count, dtype=torch.long, device=self.device)
        for length in sorted(set(map(len, prompts))):  # prompts of one length need no padding
            rows = [row for row, prompt in enumerate(prompts) if len(prompt) == length]
            tokens = torch.tensor([prompts[row] for row in rows], device=self.device)
            answers[rows] = self.network.answer(tokens, batch["pixels"][rows], count)
        return self.tokens.decode(answers).unsqueeze(1)

    @override
    def postprocess(self, actions: Tensor) -> Tensor:
        return self.scale.restore(actions)

    # --- learning -------------------------------------------------------------------------------

    @property
    @override
    def delta_indices(self) -> dict[str, list[int]]:
        return {ACTION: [0]}

    @override
    def parameter_groups(self) -> list[tuple[list[nn.Parameter], float]]:
        return [([each for each in self.model.parameters() if each.requires_grad], 1.0)]

    @override
    def loss(self, batch: dict[str, Any]) -> Loss:
        """Returns the cross entropy of the action's tokens and of the one that ends the answer."""
        actions = self.tokens.encode(self.scale.scale(batch[ACTION]))
        end = self.tokenizer.eos_token_id
        rows = [
            [*prompt, *action, end] for prompt, action in zip(batch["prompts"], actions.tolist(), strict=True)
        ]
        tokens, seen = (each.to(self.device) for each in padded(rows, end))
        labels = torch.full_like(tokens, _IGNORED)
        for row, (prompt, whole) in enumerate(zip(batch["prompts"], rows, strict=True)):
            labels[row, len(prompt) : len(whole)] = tokens[row, len(prompt) : len(whole)]
        logits = self.model(tokens, seen, batch["pixels"])[:, :-1].float()
        wanted = labels[:, 1:]
        loss = nn.functional.cross_entropy(logits.flatten(0, 1), wanted.flatten(), ignore_index=_IGNORED)
        is_action = (wanted != _IGNORED) & (wanted != end)
        found = logits.argmax(-1)
        right = ((found == wanted) & is_action).sum() / is_action.sum()
        error = (self.tokens.decode(found) - self.tokens.decode(wanted.clamp_min(0))).abs()
        l1 = (error * is_action).sum() / is_action.sum()
        return loss, {"action_accuracy": right.detach(), "action_l1": l1.detach()}

    @override
    def objective(self) -> Objective:
        return Objective(self.model, Preprocess(self), self.loss)

    # --- checkpoints ----------------------------------------------------------------------------

    @override
    def network_state(self) -> dict[str, Tensor]:
        return from_timm(self.model.state_dict())

    @override
    def load_network(self, tensors: Mapping[str, Tensor], path: Path) -> None:
        super().load_network(to_timm(tensors), path)

    @override
    def write_settings(self, directory: Path) -> None:
        content = {
            **self.network.settings,
            "model_type": self.name,
            "unnorm_key": self.unnorm_key,
            "input_features": {self._image_key: {"type": "VISUAL", "shape": list(self._image_shape)}},
            "output_features": {ACTION: {"type": "ACTION", "shape": list(self.shapes[ACTION])}},
        }
        self.tokenizer.save_pretrained(directory)
        (directory / checkpoint.CONFIG).write_text(json.dumps(content, indent=2), encoding="utf-8")

    @classmethod
    @override
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        folder = checkpoint.resolve(directory)
        content = checkpoint.read_json(folder / checkpoint.CONFIG)
        known = content.get("norm_stats") or {}
        key = content.get("unnorm_key") or (next(iter(known)) if len(known) == 1 else "")
        if key not in known:
            raise PolicyError(
                f"'{folder / checkpoint.CONFIG}' has statistics of {', '.join(known) or 'no dataset'} "
                "(norm_stats), and "
                "does not say which of them scale the actions. Add the key 'unnorm_key' with one of these."
            )
        if (folder / checkpoint.ADAPTERS).is_file():
            model = _read_model(local_folder(adapters.find_base(folder)))
            model.settings = content
            model = adapters.wrap_from(model, folder)
        else:
            model = _read_model(folder)
        image_key = next(iter(content.get("input_features") or {}), "")
        return cls(model.to(device).eval(), _read_tokenizer(folder), image_key, key)


def _read_model(folder: Path) -> OpenVla:
    """Reads the network of a checkpoint, one file or several, in the type of its weights."""
    path = checkpoint.weights_path(folder)
    config = checkpoint.read_json(folder / checkpoint.CONFIG)
    if config.get("model_type") != OpenVlaPolicy.name:
        raise PolicyError(
            f"'{folder}' is of {config.get('model_type') or config.get('type')}, not of OpenVLA."
        )
    tensors = to_timm(read_tensors(path))
    before = torch.get_default_dtype()
    torch.set_default_dtype(next(iter(tensors.values())).dtype)  # of 7 B parameters only one copy fits
    try:
        model = OpenVla(config)
    finally:
        torch.set_default_dtype(before)
    load_tensors(model, tensors, path)
    return model


def _read_tokenizer(folder: Path) -> Any:
    from transformers import AutoTokenizer

    if not any((folder / name).is_file() for name in _TOKENIZER):
        raise PolicyError(
            f"'{folder}' has no tokenizer ({' or '.join(_TOKENIZER)}). Copy it there from openvla-7b."
        )
    return AutoTokenizer.from_pretrained(str(folder))
