"""LeRobot's processors of ``multitask_act``."""

from typing import Any

from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.factory import make_default_policy_processor_steps, make_policy_processor_pipelines
from lerobot.utils.constants import OBS_STATE
from torch import Tensor

from policies.mtact.configuration_multitask_act import MultitaskActConfig
from policies.mtact.frozen_text import FrozenTextEncoder
from policies.mtact.inputs_step import MtActInputsStep


def make_multitask_act_pre_post_processors(
    config: MultitaskActConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> tuple[PolicyProcessorPipeline[Any, Any], PolicyProcessorPipeline[Any, Any]]:
    """Returns the pipelines that read instructions, normalize inputs and restore actions."""
    steps = make_default_policy_processor_steps(config, dataset_stats, normalizer_device=config.device)
    frozen = config.sentence_size > 0
    mean = (dataset_stats or {}).get(OBS_STATE, {}).get("mean")
    inputs = MtActInputsStep(
        max_words=config.max_words,
        num_buckets=config.num_buckets,
        state_fill=[] if mean is None else mean.tolist(),
        frozen=frozen,
        encoder=FrozenTextEncoder.from_folder(config.text_encoder) if frozen else None,
    )
    return make_policy_processor_pipelines(
        input_steps=[
            steps.rename_observations,
            steps.add_batch_dim,
            inputs,
            steps.to_device,
            steps.normalize,
        ],
        output_steps=[steps.unnormalize, steps.to_cpu],
    )
