"""Settings of the multi-task policy."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from envs.core.errors import PolicyError
from envs.core.ranges import check_ranges
from policies.base import listed

Head = Literal["regression", "flow"]
Backbone = Literal["keypoints", "resnet18", "resnet34"]


@dataclass(frozen=True, kw_only=True, slots=True)
class MtActConfig:
    """Multi-task action chunking with a transformer, after BAKU (arXiv:2406.07539), from scratch.

    A sentence vector scales and shifts the channels of each camera's network (FiLM, arXiv:1709.07871). A
    transformer joins tokens of the sentence, the joints and the cameras, and a decoder turns them into
    a chunk of actions.

    Attributes:
        tasks: Further tasks that are learned together with the run's task, each from demonstrations of its
            own, as in policy.tasks=[StackCube,CloseBox]; task=[PickCube,StackCube,CloseBox] is the same.
        chunk_size: Actions that one forward pass predicts.
        n_action_steps: Actions of a chunk that are executed before the next forward pass.
        head: ``regression`` predicts the actions, with the L1 loss; ``flow`` samples them by flow matching
            (arXiv:2210.02747), for demonstrations that do one thing in several ways.
        num_inference_steps: Of ``flow``: Euler steps from noise to actions.
        text_encoder: ``scratch`` learns words together with the policy; else the folder of a BERT-like
            model, which is frozen and needs the extra ``language``.
        text_layers: Of ``scratch``: transformer layers over the words of a sentence.
        max_words: Of ``scratch``: words and punctuation marks of a sentence that are read; the rest is not.
        num_buckets: Of ``scratch``: rows of the table that parts of words are hashed into.
        swap_wordings: Train each sample under a random instruction of its task, so that the wording of an
            episode says nothing of its scene. Only where all instructions of a task mean the same.
        bank_wordings: With ``swap_wordings``: also under the known wordings of its task's bank, which no
            demonstration needs to have.
        wrong_instructions: Share of the samples that training shows an instruction that is wrong in their
            scene, of another task or of none, with actions that hold still; so that a policy does nothing
            when it is asked for something else.
        sentence_noise: Of a BERT-like model: mean length of the noise that training adds to a sentence's
            vector, which has length 1, sampled for every sample. So near sentences mean the same.
        word_dropout: Of ``scratch``: share of the words that training hides, sampled for every sample.
        vision_backbone: ``keypoints``, a few convolutions, or three stages of a ResNet, with group
            normalization; both end in keypoints by spatial softmax, one network per camera.
        conv_channels: Of ``keypoints``: channels of each convolution of a camera, multiples of 8.
        n_keypoints: Keypoints of each camera.
        tokens_per_camera: Tokens that the keypoints of a camera become.
        dim_model: Width of the sentence vector and of the transformers.
        n_heads: Attention heads.
        dim_feedforward: Width of the feed-forward layers.
        n_encoder_layers: Layers of the transformer over the observation.
        n_decoder_layers: Layers of the decoder of actions.
        image_stats: Mean and standard deviation that images are normalized with: of the ``dataset``, of
            ``imagenet``, or ``half`` (0.5 and 0.5).
        mask_padding: Leave the actions after the end of an episode, which repeat its last, out of the loss.
            Without it the policy learns to hold still there.
        state_noise: Standard deviation of the noise that training adds to the normalized joint positions.
    """

    pads_tasks: ClassVar[bool] = True  # states and actions of a task may be shorter than another's

    tasks: tuple[str, ...] = ()
    chunk_size: int = 20
    n_action_steps: int = 10
    head: Head = "regression"
    num_inference_steps: int = 5
    text_encoder: str = "scratch"
    text_layers: int = 1
    max_words: int = 32
    num_buckets: int = 4096
    swap_wordings: bool = False
    bank_wordings: bool = False
    wrong_instructions: float = 0.0
    sentence_noise: float = 0.0
    word_dropout: float = 0.0
    vision_backbone: Backbone = "keypoints"
    conv_channels: tuple[int, ...] = (32, 64, 128)
    n_keypoints: int = 32
    tokens_per_camera: int = 4
    dim_model: int = 256
    n_heads: int = 4
    dim_feedforward: int = 1024
    n_encoder_layers: int = 4
    n_decoder_layers: int = 2
    image_stats: Literal["dataset", "imagenet", "half"] = "dataset"
    mask_padding: bool = False
    state_noise: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise PolicyError(
                f"policy.n_action_steps={self.n_action_steps} must be from 1 to policy.chunk_size="
                f"{self.chunk_size}: only predicted actions can be executed."
            )
        if self.dim_model <= 0 or self.dim_model % self.n_heads or self.dim_model % 2:
            raise PolicyError(
                f"policy.dim_model={self.dim_model} must be an even multiple of policy.n_heads="
                f"{self.n_heads}, such as {max(1, self.dim_model // (2 * self.n_heads)) * 2 * self.n_heads}."
            )
        if not self.conv_channels or any(width <= 0 or width % 8 for width in self.conv_channels):
            raise PolicyError(
                f"policy.conv_channels={listed(map(str, self.conv_channels))} must be multiples of 8, "
                "such as [32,64,64]."
            )
        self._check_numbers()

    def _check_numbers(self) -> None:
        from_0 = ("text_layers", "n_encoder_layers", "word_dropout", "wrong_instructions")
        from_0 += ("state_noise", "sentence_noise")
        from_1 = ("num_inference_steps", "max_words", "n_keypoints", "tokens_per_camera", "n_decoder_layers")
        check_ranges(self, "policy.", from_0=from_0, from_1=from_1, error=PolicyError)
        if self.num_buckets < 2:
            raise PolicyError(f"policy.num_buckets must be at least 2, given {self.num_buckets}.")
        if self.head not in ("regression", "flow"):
            raise PolicyError(f"policy.head must be regression or flow, given '{self.head}'.")
        if self.bank_wordings and not self.swap_wordings:
            raise PolicyError("policy.bank_wordings=true needs policy.swap_wordings=true, which draws them.")
        for name in ("word_dropout", "wrong_instructions"):
            if not getattr(self, name) < 1.0:
                raise PolicyError(f"policy.{name} must be below 1, given {getattr(self, name)}.")
        if not self.text_encoder:
            raise PolicyError("policy.text_encoder must be scratch or the folder of a model, given ''.")
