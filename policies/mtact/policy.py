"""The multi-task policy behind the interface of every policy."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, override

import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.utils.constants import ACTION, OBS_LANGUAGE, OBS_STATE
from torch import Tensor, nn

from envs.core.errors import PolicyError
from policies.base import Observation, observed
from policies.group_norm import ChannelsLastGroupNorm
from policies.learned_tasks import TASK_INDEX, Instructions, LearnedTask
from policies.lerobot_policy import Features, LeRobotPolicy, Processors
from policies.mtact.config import MtActConfig
from policies.mtact.configuration_multitask_act import SHARED, MultitaskActConfig
from policies.mtact.hashed_ngrams import without_empty_places
from policies.mtact.inputs_step import INPUTS_STEP, MtActInputsStep
from policies.mtact.modeling_multitask_act import SENTENCE, MultitaskActPolicy
from policies.mtact.processor_multitask_act import make_multitask_act_pre_post_processors
from policies.mtact.wrong_instructions import WrongInstructions
from policies.objective import Loss, Normalizer, normalizer_step
from policies.packed_convolutions import packed
from policies.swap_modules import replace_modules

INSTRUCTIONS = "task"
"""Key of an observation that holds the instructions."""


class MtActPolicy(LeRobotPolicy):
    """Multi-task action chunking by the instruction; see :class:`policies.mtact.config.MtActConfig`.

    States and actions of all tasks share one normalization, so that a position means the same number in each
    task, and nothing but the instruction says which task is meant. Those of a task with fewer joints are
    padded; padding is in no loss. ``task`` says how many entries the observations and actions have.
    """

    name = "mtact"
    model_classes: ClassVar = {"multitask_act": MultitaskActPolicy}
    processor_steps = LeRobotPolicy.processor_steps | {INPUTS_STEP}
    columns = (TASK_INDEX,)
    _mask_padding = False
    _state_noise = 0.0
    _swap_wordings = False
    _wrong_share = 0.0

    def __init__(self, model: Any, processors: Processors) -> None:
        super().__init__(model, processors)
        self._network: Any = None  # what acts, once it did; a copy of the model's on a CPU
        model.register_load_state_dict_post_hook(self._forget_network)

    @classmethod
    @override
    def lerobot_config(
        cls, config: MtActConfig, inputs: Features, outputs: Features, device: str
    ) -> PreTrainedConfig:
        shared = {name: getattr(config, name) for name in SHARED}
        return MultitaskActConfig(
            **shared, device=device, input_features=inputs, output_features=outputs, push_to_hub=False
        )

    @classmethod
    @override
    def lerobot_processors(cls, config: Any, stats: dict[str, dict[str, Tensor]]) -> Processors:
        return make_multitask_act_pre_post_processors(config, dataset_stats=stats)

    @classmethod
    @override
    def create(cls, features: Any, stats: Any, config: MtActConfig, device: str) -> "MtActPolicy":
        policy = super().create(features, stats, config, device)
        policy._mask_padding, policy._state_noise = config.mask_padding, config.state_noise
        policy._swap_wordings, policy._wrong_share = config.swap_wordings, config.wrong_instructions
        if config.text_encoder != "scratch":  # a checkpoint carries it, and need not say where it lay
            policy.model.config.text_encoder = Path(config.text_encoder).resolve().name
        task = LearnedTask(name="", state_size=policy._size(OBS_STATE), action_size=policy._size(ACTION))
        policy.learn_instructions(Instructions(texts=("",), tasks=(task,), task_of=(0,)))
        return policy

    @override
    def learn_instructions(self, instructions: Instructions) -> None:
        for task in instructions.tasks:
            largest = (self._size(OBS_STATE), self._size(ACTION))
            if task.state_size > largest[0] or task.action_size > largest[1]:
                raise PolicyError(
                    f"{task.name} has {task.state_size} joints and actions of {task.action_size} entries, "
                    f"and the policy was made for {largest[0]} and {largest[1]} at most."
                )
        language = self._inputs_step.encode(instructions.texts)
        if not language.is_floating_point():  # words, of which most sentences have far fewer than are read
            language = torch.from_numpy(without_empty_places(language.numpy()))
        language = language.to(self.device)
        self.model.table.fill(instructions, language, self._size(OBS_STATE), self._size(ACTION))
        if self._wrong_share:
            normalizer = Normalizer(normalizer_step(self.preprocessor), self.device)
            self.model.wrong = WrongInstructions(
                self._wrong_share, instructions, normalizer, self._size(ACTION), self.device
            )
        self.model.config.tasks = {
            task.name: {"state": task.state_size, "action": task.action_size}
            for task in instructions.tasks
            if task.name
        }

    @property
    def _inputs_step(self) -> MtActInputsStep:
        return next(step for step in self.preprocessor.steps if isinstance(step, MtActInputsStep))

    def _size(self, key: str, *, own: bool = False) -> int:
        """Returns the entries of the state or the action, of all tasks or of the one that it acts in."""
        largest = self.shapes[key][0]
        sizes = self.model.config.tasks.get(self.task, {}) if own else {}
        return sizes.get("state" if key == OBS_STATE else "action", largest)

    # --- acting ---------------------------------------------------------------------------------

    @override
    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        if self.model.training:  # its weights are others at each call
            self._forget_network()
        return super().act(observation, generators)[..., : self._size(ACTION, own=True)]

    @override
    def _to_tensors(self, observation: Observation) -> dict[str, Tensor]:
        images = {key: observation[key] for key in self.image_keys if key in observation}
        state = observed(observation, OBS_STATE, (self._size(OBS_STATE, own=True),), self.name)
        full = np.zeros((len(state), self._size(OBS_STATE)), np.float32)
        batch = super()._to_tensors({**images, OBS_STATE: full})
        texts = observation.get(INSTRUCTIONS)
        if texts is None or isinstance(texts, str) or len(texts) != len(state):
            raise PolicyError(
                f"The observation needs '{INSTRUCTIONS}', the instructions that policy '{self.name}' reads: "
                f"a list of {len(state)}, one text per environment. Given: {texts!r}."
            )
        language = self._inputs_step.encode([str(text) for text in texts])
        return batch | {OBS_STATE: torch.tensor(state).float(), OBS_LANGUAGE: language}

    @override
    def predict(self, batch: dict[str, Tensor], generators: Sequence[torch.Generator] | None) -> Tensor:
        """Returns normalized actions; ``head=flow`` alone samples noise, from the generators."""
        if self._network is None:
            network = self.model.model
            self._network = packed(network) if self.device.type == "cpu" else network
        config = self.model.config
        noise = is_own = None
        if config.head == "flow":
            size = self._size(ACTION)
            is_own = torch.arange(size, device=self.device) < self._size(ACTION, own=True)
            is_own = is_own.expand(len(batch[OBS_STATE]), -1)
            if generators is not None:
                shape = (1, config.chunk_size, size)
                noise = torch.cat([torch.randn(shape, generator=generator) for generator in generators])
                noise = noise.to(self.device)
        return self._network(self.model.inputs(batch), noise, is_own)

    def _forget_network(self, *_: Any) -> None:
        self._network = None

    # --- learning -------------------------------------------------------------------------------

    @property
    @override
    def delta_indices(self) -> dict[str, list[int]]:
        deltas = super().delta_indices
        if self._wrong_share:  # the action before the chunk, which a gripper that holds still keeps
            deltas[ACTION] = [-1, *deltas[ACTION]]
        return deltas

    @override
    def begin_training(self) -> None:
        if self.model.config.vision_backbone == "keypoints":
            self.model.train()  # group normalization wants channels first, so channels last would be copied
        else:
            replace_modules(self.model.model.backbones, nn.GroupNorm, ChannelsLastGroupNorm.of)
            super().begin_training()

    @override
    def end_training(self) -> None:
        self._forget_network()
        super().end_training()

    def _words_of(self, index: Tensor) -> dict[str, Tensor]:
        """Returns what the network learns of instructions by their index (B,).

        Where there are fewer of them than samples, each is read once. Hidden words and noise are each
        sample's own.
        """
        language, config = self.model.table.language, self.model.config
        if len(language) > len(index) or config.word_dropout or config.sentence_noise:
            return {OBS_LANGUAGE: language[index]}
        return {SENTENCE: self.model.model.sentence(language).index_select(0, index)}

    def _asked_wrongly(self, batch: dict[str, Tensor], asked: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Returns instructions (B,), actions (B, T, A) and whether each sample's instruction is wrong (B,).

        Args:
            batch: As :attr:`delta_indices` has it, with the action before the chunk.
            asked: The right instructions (B,).
        """
        wrong, actions = self.model.wrong, batch[ACTION]
        task = self.model.table.task[batch[TASK_INDEX].flatten()].argmax(1)
        is_wrong, drawn = wrong.draw(task)
        still = wrong.still(task, batch[OBS_STATE], actions[:, 0])
        actions = torch.where(is_wrong[:, None, None], still[:, None], actions[:, 1:])
        return torch.where(is_wrong, drawn, asked), actions, is_wrong

    @override
    def loss(self, batch: dict[str, Tensor]) -> Loss:
        """Returns the mean error of the samples, and that of each task where there are several.

        The error of a sample is the mean over the entries that its task has, so that no task counts more for
        having more joints. Samples with a wrong instruction are in no task's.
        """
        table, index = self.model.table, batch[TASK_INDEX].flatten()
        state = batch[OBS_STATE]
        if self._state_noise:
            state = state + self._state_noise * torch.randn_like(state)
        asked = table.reworded(index) if self._swap_wordings else index
        actions, is_wrong = batch[ACTION], None
        if self.model.wrong is not None:
            asked, actions, is_wrong = self._asked_wrongly(batch, asked)
        seen = {**batch, **self._words_of(asked), OBS_STATE: state * table.is_state[index]}
        is_own = table.is_action[index]
        errors = self.model.model.errors(self.model.inputs(seen), actions, is_own)
        counts = is_own[:, None].expand_as(errors)
        if self._mask_padding:
            is_pad = batch["action_is_pad"]
            if is_wrong is not None:  # holding still has no end
                is_pad = is_pad[:, 1:] & ~is_wrong[:, None]
            counts = counts & ~is_pad.unsqueeze(-1)
        of_samples = (errors * counts).sum((1, 2)) / counts.sum((1, 2)).clamp_min(1)
        loss, term = of_samples.mean(), self.model.model.decoder.term
        terms = {term: loss}
        of_tasks = table.task[index]
        if is_wrong is not None:
            terms[f"{term}/still"] = (of_samples * is_wrong).sum() / is_wrong.sum().clamp_min(1)
            of_tasks = of_tasks * ~is_wrong[:, None]
        if len(table.names) > 1:
            means = (of_samples @ of_tasks) / of_tasks.sum(0).clamp_min(1.0)
            terms |= {f"{term}/{name}": mean for name, mean in zip(table.names, means, strict=True)}
        return loss, {name: value.detach() for name, value in terms.items()}
