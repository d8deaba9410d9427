"""The processor step that turns instructions into numbers, and pads the state of a task with fewer joints."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import ProcessorStep, ProcessorStepRegistry
from lerobot.utils.constants import OBS_LANGUAGE, OBS_STATE
from torch import Tensor

from envs.core.errors import PolicyError
from policies.mtact.frozen_text import FrozenTextEncoder
from policies.mtact.hashed_ngrams import hashed

INPUTS_STEP = "mtact_inputs"


@ProcessorStepRegistry.register(name=INPUTS_STEP)
@dataclass
class MtActInputsStep(ProcessorStep):
    """Adds ``observation.language`` to an observation whose ``task`` is one text or a list of them.

    An observation that has ``observation.language`` keeps it, and one without ``task`` gets none.

    Attributes:
        max_words: Words of an instruction that are read.
        num_buckets: Rows that parts of words are hashed into.
        state_fill: What each entry of the state is where a task lacks it: the mean of those that have it.
        frozen: Whether a frozen encoder reads the instructions, in place of words that are learned.
        encoder: That encoder; one that is loaded comes from the step's state.
    """

    max_words: int = 32
    num_buckets: int = 4096
    state_fill: list[float] = field(default_factory=list)
    frozen: bool = False
    encoder: FrozenTextEncoder | None = None

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns the transition with numbers in place of text."""
        seen: dict[str, Any] = dict(transition.get(TransitionKey.OBSERVATION) or {})
        texts = _texts(transition)
        if texts is not None and OBS_LANGUAGE not in seen:
            seen[OBS_LANGUAGE] = self.encode(texts)
        state = seen.get(OBS_STATE)
        if isinstance(state, Tensor) and state.shape[-1] < len(self.state_fill):
            missing = state.new_tensor(self.state_fill[state.shape[-1] :])
            seen[OBS_STATE] = torch.cat([state, missing.expand(*state.shape[:-1], -1)], -1)
        return {**transition, TransitionKey.OBSERVATION: seen}  # type: ignore[return-value]

    def encode(self, texts: Sequence[str]) -> Tensor:
        """Returns the numbers of n instructions: int64 (n, W, P) of words, or float32 (n, E) of an encoder.

        Raises:
            PolicyError: if the encoder is absent.
        """
        if not self.frozen:
            return torch.from_numpy(hashed(texts, self.max_words, self.num_buckets))
        if self.encoder is None:
            raise PolicyError(
                "The checkpoint has no text encoder: the file beside its preprocessor is missing."
            )
        return self.encoder.vectors(texts)

    def get_config(self) -> dict[str, Any]:
        """Returns the settings."""
        names = ("max_words", "num_buckets", "state_fill", "frozen")
        return {name: getattr(self, name) for name in names}

    def state_dict(self) -> dict[str, Tensor]:
        """Returns the encoder, if there is one."""
        return {} if self.encoder is None else self.encoder.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Takes the encoder of :meth:`state_dict`."""
        if state:
            self.encoder = FrozenTextEncoder.from_state_dict(state)

    def transform_features(self, features: Any) -> Any:
        """Returns the features as they are: the policy's inputs do not list the instruction."""
        return features


def _texts(transition: EnvTransition) -> list[str] | None:
    task = (transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}).get("task")
    if task is None:
        return None
    if isinstance(task, str):
        return [task]
    if isinstance(task, Sequence | np.ndarray) and len(task) and all(isinstance(text, str) for text in task):
        return [str(text) for text in task]
    raise PolicyError(
        f"'task' must be the instructions, one text per environment, which policy 'mtact' reads; "
        f"given {task!r}."
    )
