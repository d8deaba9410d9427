"""What gradient steps minimize is LeRobot's loss of LeRobot's normalization, in one piece."""

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

import policies
from envs.core.errors import PolicyError
from policies.objective import Normalizer, normalizer_step
from tests.policies.examples import LEARNED, make
from tests.policies.test_closed_forms import raw_batch_of

pytestmark = pytest.mark.slow

VARIANTS = [
    ("act", {"use_vae": True}),
    ("act", {"use_vae": False}),
    ("diffusion", {}),
    ("diffusion", {"vision_backbone": "keypoints"}),
]


def loss_of(compute):
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(5)
        return compute()


@pytest.mark.parametrize("name", LEARNED)
def test_the_normalizer_changes_no_bit_of_lerobots(name):
    if not hasattr(policies.policy_class(name), "objective"):
        pytest.skip(f"{name} learns from no dataset")
    policy = make(name)
    raw = raw_batch_of(policy)
    theirs = policy.preprocess(raw)
    ours = Normalizer(normalizer_step(policy.preprocessor), policy.device)(raw)
    for key, value in raw.items():
        assert ours[key].equal(theirs[key]), key
        assert value.dtype is torch.bool or not ours[key].equal(value)


@pytest.mark.parametrize(("name", "changes"), VARIANTS)
def test_the_loss_and_its_gradient_are_lerobots(name, changes):
    policy = make(name, **changes)
    policy.begin_training()
    raw = raw_batch_of(policy)
    raw["action_is_pad"][1, 3:] = True
    gradients = []
    for compute in (
        lambda: policy.model(policy.preprocess(raw))[0],
        lambda: policy.objective()(raw)[0],
    ):
        policy.model.zero_grad()
        loss = loss_of(compute)
        loss.backward()
        gradients.append([p.grad.clone() for p in policy.model.parameters() if p.grad is not None])
        gradients[-1].append(loss.detach())
    for theirs, ours in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "changes"), [VARIANTS[0], pytest.param(*VARIANTS[1], marks=pytest.mark.long), *VARIANTS[2:]]
)
def test_the_whole_of_it_is_one_graph(name, changes):
    """``fullgraph`` raises where Python would have to step in."""
    policy = make(name, **changes)
    policy.begin_training()
    objective, raw = policy.objective(), raw_batch_of(policy)
    eager = loss_of(lambda: objective(raw)[0])
    objective.compile(fullgraph=True, dynamic=False, backend="eager")
    torch.testing.assert_close(loss_of(lambda: objective(raw)[0]), eager, rtol=1e-5, atol=1e-6)


class HostTensors(TorchDispatchMode):
    """Notes the operations that have to do with a tensor of the CPU."""

    def __init__(self):
        super().__init__()
        self.operations = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        out = func(*args, **(kwargs or {}))
        tensors = [leaf for leaf in tree_leaves((args, kwargs, out)) if isinstance(leaf, torch.Tensor)]
        if any(tensor.device.type == "cpu" for tensor in tensors):
            self.operations.append(str(func))
        return out


@pytest.mark.parametrize(("name", "changes"), VARIANTS[:3])
def test_a_step_touches_no_tensor_of_the_cpu(name, changes):
    """A copy from there waits for the GPU, and cannot be recorded as a CUDA graph.

    Keypoints switch autocast off, which the device ``meta`` does not have: the test of the GPU records them.
    """
    policy = make(name, **changes)
    policy.begin_training()
    raw = {key: value.to("meta") for key, value in raw_batch_of(policy).items()}
    objective = policy.objective().to("meta")
    policy.model.config.device = "meta"
    objective(raw)  # tables that are made once
    with HostTensors() as host:
        objective(raw)
    assert host.operations == []


def test_a_mode_of_normalization_that_is_not_known_is_refused():
    from lerobot.configs import NormalizationMode

    step = normalizer_step(make("act").preprocessor)
    step.norm_map = dict.fromkeys(step.norm_map, NormalizationMode.QUANTILES)
    with pytest.raises(PolicyError, match="is normalized by QUANTILES, which training does not support"):
        Normalizer(step, torch.device("cpu"))
