"""Any policy of LeRobot's registry behind the interface of ours.

Shapes: n environments or samples, T observations in time, C, H, W an image, A action size.
"""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, override

import numpy as np
import torch
from lerobot.configs import FeatureType
from lerobot.policies.utils import populate_queues
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE
from torch import Tensor, nn

from envs.core.errors import PolicyError
from policies import checkpoint
from policies.base import Observation
from policies.learned_tasks import TASK_INDEX
from policies.lerobot_policy import Features, LeRobotPolicy, Processors, policy_features
from policies.module_policy import seeded
from policies.objective import Loss, Objective, Preprocess
from policies.zoo import adapters, building
from policies.zoo.assets import write_assets
from policies.zoo.blocks import BlockwiseObjective
from policies.zoo.config import LeRobotConfig, full_rename_map
from policies.zoo.features import keep_cameras, matched_inputs, statistics
from policies.zoo.fine_tuned import TASK, FineTunedPolicy
from policies.zoo.preflight import NEEDS_NOTHING, check_lerobot
from policies.zoo.source import base_name
from policies.zoo.state_noise import NoisyState
from policies.zoo.types import DROP_LAST_FRAMES, STATE_NOISE

logger = logging.getLogger(__name__)


class LeRobotZooPolicy(FineTunedPolicy, LeRobotPolicy):
    """A policy of any type, with LeRobot's own processors, loss and weights.

    Attributes:
        assets: Folder of each tokenizer and backbone that a checkpoint carried.
        rename_map: Key of the environment or dataset to key of the policy, of each camera that has another
            name.
        sees_any_size: Whether images of any size are taken, because the policy resizes them.
    """

    name = "lerobot"

    def __init__(
        self, model: Any, processors: Processors, assets: Mapping[str, str], rename_map: Mapping[str, str]
    ) -> None:
        super().__init__(model, processors)
        self.assets, self.rename_map = dict(assets), dict(rename_map)
        self.sees_any_size = self.model.config.type not in NEEDS_NOTHING
        self._preset = False
        self._dropped: int | None = None
        self._noise: NoisyState | None = None

    @classmethod
    @override
    def create(
        cls,
        features: Mapping[str, Any],
        stats: Mapping[str, Mapping[str, Any]],
        config: LeRobotConfig,
        device: str,
    ) -> Self:
        check_lerobot(config, features)
        inputs, outputs = policy_features(features)
        rename = full_rename_map(config.rename_map)
        if config.path:
            base = building.read_base(config, device)
            matched_inputs(base.config, inputs, rename)
            base.config.output_features = outputs
            model = building.build(base.config, base.assets, base.tensors, base.weights_path)
            assets, folder = base.assets, base.folder
        else:
            settings = building.lerobot_config(config, device)
            settings.input_features = {rename.get(key, key): feature for key, feature in inputs.items()}
            settings.output_features = outputs
            model, assets, folder = building.build(settings, {}, None, None), {}, None
        named = {rename.get(key, key): value for key, value in stats.items()}
        own_stats = statistics(model.config, named)
        processors = building.make_processors(
            model.config, folder, own_stats, assets, rename, device, tokenizer=config.tokenizer
        )
        if config.peft.method_type:
            model = adapters.wrap(model, config.peft, base_name(config.path))
        policy = cls(model.to(device).eval(), processors, assets, rename)
        policy._preset = config.use_policy_training_preset
        policy._dropped = config.settings.get(DROP_LAST_FRAMES)
        if noise := config.settings.get(STATE_NOISE, 0.0):
            policy._noise = NoisyState.of(stats[OBS_STATE]["std"], noise)
        return policy

    @override
    def begin_with(self, directory: str | Path) -> None:
        raise PolicyError(
            f"policy=lerobot goes on with a checkpoint by policy.path={directory}, not by train.resume_from."
        )

    # --- acting ---------------------------------------------------------------------------------

    @property
    @override
    def n_action_steps(self) -> int:
        config = self.model.config  # VQ-BeT has another name for it
        return getattr(config, "n_action_steps", None) or config.action_chunk_size

    @property
    @override
    def features(self) -> Features:
        sources: dict[str, str] = {target: source for source, target in self.rename_map.items()}
        config = self.model.config
        seen: Features = {
            str(sources.get(key, key)): feature for key, feature in config.input_features.items()
        }
        return seen | {ACTION: config.output_features[ACTION]}

    @property
    @override
    def image_keys(self) -> list[str]:
        return [key for key, feature in self.features.items() if feature.type is FeatureType.VISUAL]

    def see(self, cameras: Sequence[str], rename_map: Mapping[str, str]) -> None:
        """Maps the cameras of an environment to those of the policy, before it acts.

        Args:
            cameras: Names of the environment's cameras.
            rename_map: Camera of the environment to camera of the policy; names alone, or keys of
                observations.

        Raises:
            PolicyError: if a camera of the policy is none of the environment.
        """
        self.rename_map |= full_rename_map(dict(rename_map))
        building.set_rename_map(self.preprocessor, self.rename_map)
        keep_cameras(self.model.config, cameras, self.rename_map)

    @override
    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        n = len(next(iter(observation.values())))
        if self.batch_invariant and n > 1:  # a longer instruction beside it would pad a sample's own
            rows = [{key: value[i : i + 1] for key, value in observation.items()} for i in range(n)]
            each = [None] * n if generators is None else [[generator] for generator in generators]
            return np.concatenate(
                [super(LeRobotZooPolicy, self).act(*pair) for pair in zip(rows, each, strict=True)]
            )
        return super().act(observation, generators)

    @override
    def _to_tensors(self, observation: Observation) -> dict[str, Any]:
        if self.sees_any_size:
            observation = dict(observation)
            for key in self.image_keys:
                if key in observation:
                    height, width = np.asarray(observation[key]).shape[-3:-1]
                    self._resize_feature(key, int(height), int(width))
        return super()._to_tensors(observation)

    def _resize_feature(self, key: str, height: int, width: int) -> None:
        """Notes the size of a camera's images, which the policy resizes by itself."""
        feature = self.model.config.input_features[self.rename_map.get(key, key)]
        feature.shape = (feature.shape[0], height, width)

    @override
    def preprocess(self, batch: Mapping[str, Any]) -> dict[str, Any]:
        floats: dict[str, Any] = {}
        for key, value in batch.items():
            if key in (TASK, TASK_INDEX):
                continue
            value = value.to(self.device, non_blocking=True)
            is_bytes = value.dtype is torch.uint8 and key in self.image_keys
            floats[key] = value.float().div_(255.0) if is_bytes else value
        floats[TASK] = self.words(batch, len(next(iter(floats.values()))))
        processed = self.preprocessor(floats)
        # EO-1's processor hands its network the ids of two tokens as numbers; flags of LeRobot are none.
        return {
            key: value
            for key, value in processed.items()
            if isinstance(value, Tensor | list | int) and not isinstance(value, bool)
        }

    @override
    def predict(self, batch: dict[str, Any], generators: Sequence[torch.Generator] | None) -> Tensor:
        with seeded(generators, self.device):
            network = self.network
            network.reset()
            if OBS_STATE in (getattr(network, "_queues", None) or {}):
                batch = self._with_history(network, batch)
            actions = network.predict_action_chunk(batch)
        return actions[..., : self.shapes[ACTION][0]]

    def _with_history(self, network: Any, batch: dict[str, Any]) -> dict[str, Any]:
        """Fills the queues of a policy that looks back, oldest observation first; returns the newest."""
        images = [key for key in network.config.image_features if key in batch]
        keys = [key for key in network.config.input_features if key in batch]
        single = self.n_obs_steps == 1
        frame = batch
        for t in range(self.n_obs_steps):
            frame = batch | {key: batch[key] if single else batch[key][:, t] for key in keys}
            if images:
                frame[OBS_IMAGES] = torch.stack([frame[key] for key in images], dim=-4)
            network._queues = populate_queues(network._queues, frame, exclude_keys=[ACTION])
        return {key: value for key, value in frame.items() if key != ACTION}

    # --- learning -------------------------------------------------------------------------------

    @property
    @override
    def delta_indices(self) -> dict[str, list[int]]:
        config = self.model.config
        deltas = {ACTION: list(config.action_delta_indices)}
        if config.observation_delta_indices is not None:
            window = list(config.observation_delta_indices)
            deltas |= {key: window for key in self.shapes if key != ACTION}
        return deltas

    @property
    @override
    def drop_last_frames(self) -> int:
        if self._dropped is not None:
            return self._dropped
        return getattr(self.model.config, DROP_LAST_FRAMES, 0) or 0

    @override
    def training_config(self, config: Any) -> Any:
        return building.with_preset(self.network, config) if self._preset else config

    @override
    def parameter_groups(self) -> list[tuple[list[nn.Parameter], float]]:
        return building.parameter_groups(self.model, self.network)

    @override
    def begin_training(self) -> None:
        self.model.train()

    @override
    def end_training(self) -> None:
        self.model.eval()

    @override
    def loss(self, batch: dict[str, Any]) -> Loss:
        loss, terms = self.model(batch)
        numbers = {name: value for name, value in (terms or {}).items() if isinstance(value, float | Tensor)}
        tensors = {name: torch.as_tensor(value, device=loss.device) for name, value in numbers.items()}
        return loss, {
            name: value.detach().float()
            for name, value in tensors.items()
            if name != "loss" and value.ndim == 0
        }

    @override
    def objective(self) -> Objective:
        return BlockwiseObjective(self.model, Preprocess(self, self._noise), self.loss)

    # --- checkpoints ----------------------------------------------------------------------------

    @override
    def write_settings(self, directory: Path) -> None:
        config = self.model.config
        config._save_pretrained(directory)
        self.preprocessor.save_pretrained(directory)
        self.postprocessor.save_pretrained(directory)
        write_assets(directory, config.type, config, self.preprocessor, self.assets)
        building.restore_names(directory, self.assets)

    @classmethod
    @override
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        folder = checkpoint.resolve(directory)
        read = building.read_folder(folder, device)
        model = building.build(read.config, read.assets, read.tensors, read.weights_path)
        if read.adapters:
            model = adapters.wrap_from(model, folder)
        rename = building.saved_rename_map(folder)
        processors = building.make_processors(read.config, folder, None, read.assets, rename, device)
        return cls(model.to(device).eval(), processors, read.assets, rename)
