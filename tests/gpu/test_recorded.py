"""What is recorded beside a loss: functions of tensors, updates of the weights, and changes of images."""

import pytest
import torch

import policies
from policies.cuda_graphs import WARMUP_CALLS, Recorded
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.imitation.ema import Ema
from roboverse_learn.training.imitation.image_augmentation import augment
from roboverse_learn.training.imitation.optimizer import make_optimizer
from roboverse_learn.training.imitation.update import Update
from tests.gpu.test_image_augmentation import ALL
from tests.policies.examples import CONFIGS, FEATURES, stats

pytestmark = pytest.mark.gpu

STEPS = WARMUP_CALLS + 4


def test_results_are_those_of_each_call_and_stay():
    total = torch.zeros(3, device="cuda")

    def add(numbers, more):
        total.add_(numbers)
        return {"sum": total + 0.0, "both": (numbers * more, more)}

    recorded, calls = Recorded(add), range(1, STEPS + 1)
    two = torch.tensor(2.0, device="cuda")
    found = [recorded(torch.full((3,), float(call), device="cuda"), two) for call in calls]
    assert [float(each["sum"][0]) for each in found] == [call * (call + 1) / 2 for call in calls]
    assert [float(each["both"][0][0]) for each in found] == [2.0 * call for call in calls]


def test_another_number_of_tensors_is_refused():
    recorded = Recorded(lambda *tensors: sum(tensors))
    given = [torch.ones(2, device="cuda")] * 2
    for _ in range(WARMUP_CALLS):
        recorded(*given)
    with pytest.raises(TypeError, match="2 tensors were recorded, and 3 are given"):
        recorded(*given, given[0])


def test_a_call_does_not_wait_for_the_gpu():
    recorded = Recorded(lambda x: x @ x)
    matrix = torch.eye(4096, device="cuda")
    for _ in range(WARMUP_CALLS):
        recorded(matrix)
    torch.cuda.synchronize()
    for _ in range(20):
        recorded(matrix)
    last = torch.cuda.Event()
    last.record()
    assert not last.query(), "20 products of this size take tens of milliseconds"


def test_recorded_changes_of_images_are_those_of_the_same_seed():
    images = torch.randint(0, 256, (16, 3, 32, 32), dtype=torch.uint8, device="cuda")
    recorded = Recorded(lambda given: augment(given, ALL))
    for seed in range(STEPS):
        torch.manual_seed(seed)
        found, next_found = recorded(images), torch.rand(1, device="cuda")
        torch.manual_seed(seed)
        expected, next_expected = augment(images, ALL), torch.rand(1, device="cuda")
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=0)
        assert next_found.equal(next_expected), "what is drawn afterwards"
        images = images.roll(1, 0)


@pytest.mark.parametrize("lr_muon", [None, 5e-3])
@pytest.mark.parametrize("grad_clip", [0.0, 0.5])
def test_recorded_updates_are_those_of_eager_code(lr_muon, grad_clip):
    config = TrainConfig(lr=1e-3, lr_backbone=1e-4, lr_muon=lr_muon, weight_decay=0.1)
    found, norms = {}, {}
    for record in (False, True):
        policy = policies.create("act", FEATURES, stats(), CONFIGS["act"], "cuda", seed=0)
        ema = Ema(policy.state_dict(), power=0.75, max_decay=0.9)
        update = Update(policy, make_optimizer(policy, config), ema, grad_clip=grad_clip, record=record)
        rng, norms[record] = torch.Generator("cuda").manual_seed(0), []
        trained = [each for each in policy.model.parameters() if each.requires_grad]
        for step in range(STEPS):
            for parameter in trained:
                parameter.grad = torch.randn(parameter.shape, device="cuda", generator=rng)
            norms[record].append(update(1.0 - step / STEPS))
            assert all(each.grad is None for each in trained)
        assert ema.num_updates == STEPS
        found[record] = {**policy.state_dict(), **{f"average.{k}": v for k, v in ema.average.items()}}
    torch.testing.assert_close(norms[True], norms[False])
    torch.testing.assert_close(found[True], found[False], atol=2e-5, rtol=1e-4)
    first = policies.create("act", FEATURES, stats(), CONFIGS["act"], "cuda", seed=0).state_dict()
    moved = [key for key, value in first.items() if not value.equal(found[True][key])]
    assert len(moved) >= len(trained)
