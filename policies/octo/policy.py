"""Octo behind the interface of every policy.

Shapes: n environments or samples, T observations in time, H actions of a chunk, A numbers of an action, W
tokens of an instruction.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
from policies.octo.config import OctoConfig
from policies.octo.diffusion import DiffusionHead
from policies.octo.flax_names import from_flax
from policies.octo.network import Octo
from policies.octo.sizes import OctoSizes, sizes_of
from policies.zoo import adapters
from policies.zoo.config import full_rename_map
from policies.zoo.fine_tuned import FineTunedPolicy
from policies.zoo.source import base_name, local_folder
from policies.zoo.weights import load_tensors, read_tensors

CONVERTED = "flax.safetensors"
"""Weights of a folder that ``policies/octo/convert.py`` wrote."""

_PRESENT, _WORDS = "present", "words"
_LEAST_DEVIATION = 1e-3
"""Of an action's number that hardly varies, by which it would be divided."""


class OctoPolicy(FineTunedPolicy):
    """Octo, arXiv:2405.12213: a chunk of actions by diffusion from images and an instruction.

    Attributes:
        cameras: Its own name of each camera, ``primary`` or ``wrist``, to the dataset's key.
    """

    name = "octo"
    trained = "full"

    def __init__(self, model: Any, tokenizer: Any, content: Mapping[str, Any]) -> None:
        self.model, self.tokenizer, self.content = model, tokenizer, dict(content)
        self.cameras: dict[str, str] = dict(content["cameras"])
        self._image_shapes = {
            key: tuple(feature["shape"]) for key, feature in content["input_features"].items()
        }
        self.window = int(content["window_size"])
        norm = content["norm"]
        self._mean, self._deviation = (
            torch.tensor(norm[key], dtype=torch.float32) for key in ("mean", "std")
        )
        self._known: dict[str, Tensor] = {}
        self.batch_invariant = self.device.type == "cpu"

    @classmethod
    @override
    def create(
        cls,
        features: Mapping[str, Any],
        stats: Mapping[str, Mapping[str, Any]],
        config: OctoConfig,
        device: str,
    ) -> Self:
        if not config.path:
            raise PolicyError(
                "policy=octo fine-tunes a published checkpoint: give policy.path=<folder>, as "
                "policies/octo/convert.py writes it from octo-small-1.5 or octo-base-1.5."
            )
        inputs, outputs = policy_features(features)
        seen = {key: feature.shape for key, feature in inputs.items() if feature.type is FeatureType.VISUAL}
        folder = local_folder(config.path)
        content = checkpoint.read_json(folder / checkpoint.CONFIG)
        model, sizes = _read_model(folder, content), sizes_of(content)
        if config.window > sizes.max_horizon:
            raise PolicyError(
                f"policy.window={config.window} is more than the {sizes.max_horizon} observations of Octo."
            )
        _set_sizes(model, replace(sizes, action_dim=outputs[ACTION].shape[0], chunk_size=config.chunk_size))
        cameras = _cameras(config, sizes, list(seen))
        of_action = stats[ACTION]
        numbers = {
            key: [float(each) for each in torch.as_tensor(of_action[key]).reshape(-1)]
            for key in ("mean", "std")
        }
        own = {
            "cameras": cameras,
            "norm": numbers,
            "window_size": config.window,
            "input_features": {key: {"type": "VISUAL", "shape": list(seen[key])} for key in cameras.values()},
        }
        if config.peft.method_type:
            base, parts = base_name(config.path), ("text_encoder", "head")
            model = adapters.wrap_own(model, config.peft, base, what="Octo", without=parts, in_full=parts[1:])
        policy = cls(model.to(device).eval(), _read_tokenizer(folder), {**content, **own})
        policy.trained = config.trained
        return policy

    # --- what it takes and gives ----------------------------------------------------------------

    @property
    @override
    def device(self) -> torch.device:
        return next(self.model.parameters()).device

    @property
    @override
    def n_obs_steps(self) -> int:
        return self.window

    @property
    @override
    def n_action_steps(self) -> int:
        return self.network.sizes.chunk_size

    @property
    @override
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        return {**self._image_shapes, ACTION: (self.network.sizes.action_dim,)}

    @property
    @override
    def image_keys(self) -> Sequence[str]:
        return list(self.cameras.values())

    def see(self, cameras: Sequence[str], rename_map: Mapping[str, str]) -> None:
        """Chooses the cameras that it sees: those that ``rename_map`` names, or its own."""
        renamed = {target: source for source, target in full_rename_map(dict(rename_map)).items()}
        keys = [IMAGE_PREFIX + name for name in cameras]
        for name, key in self.cameras.items():
            chosen = renamed.get(key, renamed.get(IMAGE_PREFIX + name, key))
            if chosen not in keys:
                raise PolicyError(
                    f"Octo sees the camera {chosen.removeprefix(IMAGE_PREFIX)} as {name}, and the task has "
                    f"{', '.join(cameras) or 'none'}. Name the one to see, as in "
                    f"'rename_map={{<camera>:{name}}}'."
                )
            self.cameras[name] = chosen
            self._image_shapes[chosen] = self._image_shapes.pop(key)

    # --- acting ---------------------------------------------------------------------------------

    @override
    def _to_tensors(self, observation: Observation) -> dict[str, Any]:
        for key in self.image_keys:  # of any size, for they are resized
            if key in observation:
                height, width = np.asarray(observation[key]).shape[-3:-1]
                self._image_shapes[key] = (3, int(height), int(width))
        return super()._to_tensors(observation)

    @override
    def preprocess(self, batch: Mapping[str, Any]) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for name, key in self.cameras.items():
            images = batch[key].to(self.device, non_blocking=True)
            images = images.float() / 255.0 if images.dtype is torch.uint8 else images.float()
            images = images if images.ndim == 5 else images.unsqueeze(1)
            size = self.network.sizes.cameras[name]
            resized = nn.functional.interpolate(
                images.flatten(0, 1), (size, size), mode="bilinear", antialias=True
            )
            out[name] = 2.0 * resized.unflatten(0, images.shape[:2]) - 1.0
            if f"{key}_is_pad" in batch:
                out[_PRESENT] = ~batch[f"{key}_is_pad"].to(self.device)
        out[_WORDS] = self._words_of(batch, len(out[next(iter(self.cameras))]))
        if ACTION in batch:
            mean, deviation = self._scale()
            out[ACTION] = (batch[ACTION].to(self.device).float() - mean) / deviation
            if f"{ACTION}_is_pad" in batch:
                out[f"{ACTION}_is_pad"] = batch[f"{ACTION}_is_pad"].to(self.device)
        return out

    def _words_of(self, batch: Mapping[str, Any], count: int) -> Tensor:
        """Returns the vectors (n, W, E) of the instructions, each encoded once: the encoder is frozen."""
        texts = self.words(batch, count)
        if new := [text for text in dict.fromkeys(texts) if text not in self._known]:
            length = self.network.sizes.text_tokens
            found = self.tokenizer(
                new, padding="max_length", truncation=True, max_length=length, return_tensors="pt"
            )
            vectors = self.network.words(
                found["input_ids"].to(self.device), found["attention_mask"].to(self.device)
            )
            self._known |= dict(zip(new, vectors.clone(), strict=True))
        return torch.stack([self._known[text] for text in texts])

    def _scale(self) -> tuple[Tensor, Tensor]:
        """Returns mean and deviation of the actions, (A,)."""
        return self._mean.to(self.device), self._deviation.to(self.device).clamp_min(_LEAST_DEVIATION)

    @override
    def predict(self, batch: dict[str, Any], generators: Sequence[torch.Generator] | None) -> Tensor:
        readout = self._readout(batch)[:, -1]
        head = self.network.head
        shape = (1 + head.steps, head.numbers)
        each = [None] * len(readout) if generators is None else generators
        noise = torch.stack([torch.randn(shape, generator=generator) for generator in each], 1)
        actions = head.sample(readout, list(noise.to(self.device)))
        return actions.unflatten(-1, (self.network.sizes.chunk_size, -1))

    def _readout(self, batch: Mapping[str, Any]) -> Tensor:
        images = {name: batch[name] for name in self.cameras}
        return self.model(images, batch[_WORDS], batch.get(_PRESENT))

    @override
    def postprocess(self, actions: Tensor) -> Tensor:
        mean, deviation = self._scale()
        return actions * deviation + mean

    # --- learning -------------------------------------------------------------------------------

    @property
    @override
    def delta_indices(self) -> dict[str, list[int]]:
        before = list(range(1 - self.window, 1))
        images = {key: before for key in self.image_keys} if self.window > 1 else {}
        return {**images, ACTION: [*before, *range(1, self.network.sizes.chunk_size)]}

    @override
    def parameter_groups(self) -> list[tuple[list[nn.Parameter], float]]:
        module = self.network.head if self.trained == "head" else self.model
        return [([each for each in module.parameters() if each.requires_grad], 1.0)]

    @override
    def begin_training(self) -> None:
        self.model.train()
        self.network.text_encoder.eval()

    @override
    def loss(self, batch: dict[str, Any]) -> Loss:
        """Returns the squared error of the noise, summed over an action's numbers as its authors do."""
        sizes = self.network.sizes
        readout = self._readout(batch)
        actions = batch[ACTION].unfold(1, sizes.chunk_size, 1).transpose(2, 3)  # (n, T, H, A)
        flat = actions.flatten(2).flatten(0, 1)
        time = torch.randint(0, sizes.diffusion_steps, (len(flat), 1), device=self.device)
        errors = self.network.head.errors(readout.flatten(0, 1), flat, torch.randn_like(flat), time)
        counts = torch.ones_like(actions)
        if f"{ACTION}_is_pad" in batch:
            counts = counts * ~batch[f"{ACTION}_is_pad"].unfold(1, sizes.chunk_size, 1)[..., None]
        if _PRESENT in batch:
            counts = counts * batch[_PRESENT][:, :, None, None]
        counts = counts.flatten(2).flatten(0, 1)
        mse = (errors * counts).sum() / counts.sum().clamp_min(1.0)
        return sizes.action_dim * mse, {"noise_mse": mse.detach()}

    @override
    def objective(self) -> Objective:
        return Objective(self.model, Preprocess(self), self.loss)

    # --- checkpoints ----------------------------------------------------------------------------

    @override
    def load_state_dict(self, tensors: Mapping[str, Tensor], path: Path) -> None:
        super().load_state_dict(tensors, path)
        self._known.clear()

    @override
    def write_settings(self, directory: Path) -> None:
        sizes = self.network.sizes
        content = json.loads(json.dumps(self.content))
        content["model"]["heads"]["action"]["kwargs"] |= {
            "action_dim": sizes.action_dim, "action_horizon": sizes.chunk_size
        }  # fmt: skip
        content |= {
            "model_type": self.name,
            "cameras": self.cameras,
            "input_features": {
                key: {"type": "VISUAL", "shape": list(self._image_shapes[key])} for key in self.image_keys
            },
            "output_features": {ACTION: {"type": "ACTION", "shape": [sizes.action_dim]}},
        }
        self.tokenizer.save_pretrained(directory)
        (directory / checkpoint.CONFIG).write_text(json.dumps(content, indent=2), encoding="utf-8")

    @classmethod
    @override
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        folder = checkpoint.resolve(directory)
        content = checkpoint.read_json(folder / checkpoint.CONFIG)
        if "norm" not in content or "cameras" not in content:
            raise PolicyError(
                f"'{folder}' is an Octo as it was published, whose actions are those of the robots that it "
                f"learned. Fine-tune it first: roboverse train policy=octo policy.path={folder} task=<name>."
            )
        if (folder / checkpoint.ADAPTERS).is_file():
            base = local_folder(adapters.find_base(folder))
            plain = _read_model(base, checkpoint.read_json(base / checkpoint.CONFIG))
            _set_sizes(plain, sizes_of(content))
            model = adapters.wrap_from(plain, folder)
        else:
            model = _read_model(folder, content)
        return cls(model.to(device).eval(), _read_tokenizer(folder), content)


def _cameras(config: OctoConfig, sizes: OctoSizes, keys: Sequence[str]) -> dict[str, str]:
    """Returns Octo's name of each camera to the dataset's key.

    Raises:
        PolicyError: The dataset or this Octo has no such camera.
    """
    first = next(iter(keys), "").removeprefix(IMAGE_PREFIX)
    found = {"primary": config.primary or first, "wrist": config.wrist}
    given = {name: IMAGE_PREFIX + camera for name, camera in found.items() if camera}
    names = ", ".join(key.removeprefix(IMAGE_PREFIX) for key in keys) or "none"
    for name, key in given.items():
        if key not in keys:
            raise PolicyError(
                f"policy.{name}={key.removeprefix(IMAGE_PREFIX)} is no camera of the dataset, which has "
                f"{names}."
            )
        if name not in sizes.cameras:
            raise PolicyError(f"This Octo has no camera {name}; it has {', '.join(sizes.cameras)}.")
    if not given:
        raise PolicyError("Octo sees images, and the dataset has no camera.")
    return given


def _set_sizes(model: Octo, wanted: OctoSizes) -> None:
    """Gives a network a new head where its actions are others; its authors begin a new one for them, too."""
    if wanted != model.sizes:
        model.head, model.sizes = DiffusionHead(wanted), wanted


def _read_model(folder: Path, content: Mapping[str, Any]) -> Octo:
    """Reads the network of a converted folder, or of a checkpoint of ours."""
    if content.get("model_type") != OctoPolicy.name:
        raise PolicyError(
            f"'{folder}' is of {content.get('model_type') or content.get('type')}, not of Octo."
        )
    converted = folder / CONVERTED
    path = converted if converted.is_file() else checkpoint.weights_path(folder)
    tensors = read_tensors(path)
    model = Octo(sizes_of(content))
    load_tensors(model, from_flax(tensors) if path == converted else tensors, path)
    return model


def _read_tokenizer(folder: Path) -> Any:
    from transformers import AutoTokenizer

    if not (folder / "tokenizer.json").is_file():
        raise PolicyError(f"'{folder}' has no tokenizer.json. Copy it there from t5-base.")
    return AutoTokenizer.from_pretrained(str(folder))
