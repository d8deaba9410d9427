"""The parts of the training loop, against closed forms."""

import os
from io import StringIO

import pytest
import torch
from rich.console import Console

from envs.core.errors import ConfigError
from roboverse_learn.training.config import AugmentConfig, TrainConfig
from roboverse_learn.training.device import cpu_threads, resolve_device, resolve_precision
from roboverse_learn.training.imitation.ema import Ema
from roboverse_learn.training.imitation.image_augmentation import augment, shift
from roboverse_learn.training.metrics import JsonlWriter, read_metrics
from roboverse_learn.training.randomness import step_seed
from roboverse_learn.training.reporter import Progress, ProgressReporter


def test_ema_with_a_constant_decay_is_a_geometric_mean():
    ema = Ema({"w": torch.zeros(1)}, power=1.0, max_decay=0.5, num_updates=1)
    values = [1.0, 5.0, -2.0]
    for value in values:
        ema.update({"w": torch.tensor([value])})
    expected = sum(value * 0.5 ** (len(values) - i) for i, value in enumerate(values))
    assert ema.average["w"].item() == pytest.approx(expected)


def test_ema_with_power_one_is_the_plain_mean():
    """With power 1 the decay is t / (t + 1), so that every update weighs the same."""
    ema = Ema({"w": torch.zeros(1)}, power=1.0, max_decay=1.0)
    for value in (3.0, 4.0, 8.0):
        ema.update({"w": torch.tensor([value])})
    assert ema.average["w"].item() == pytest.approx(5.0)


def test_ema_copies_what_is_not_floating_and_shares_no_memory():
    weights = {"w": torch.ones(1), "count": torch.tensor(1)}
    ema = Ema(weights, power=0.75, max_decay=0.9999)
    weights["w"] += 1.0
    assert ema.average["w"].item() == 1.0
    ema.update(weights | {"count": torch.tensor(7)})
    assert ema.average == {"w": torch.tensor([2.0]), "count": torch.tensor(7)}


def test_seeds_differ_between_steps_and_processes():
    seeds = {step_seed(seed, step, rank) for seed in range(3) for step in range(50) for rank in range(2)}
    assert len(seeds) == 300


def test_shift_moves_whole_pixels_and_repeats_the_border():
    image = torch.arange(9, dtype=torch.uint8).reshape(1, 1, 3, 3)
    moved = shift(image, torch.tensor([[1, -1]]))
    assert moved[0, 0].tolist() == [[3, 3, 4], [6, 6, 7], [6, 6, 7]]


def test_shift_of_images_wider_than_high_moves_each_sample_by_its_own_offset():
    images = torch.randint(0, 256, (2, 3, 1, 4, 7), generator=torch.Generator().manual_seed(0))
    moved = shift(images, torch.tensor([[2, 0], [0, -3]]))
    assert moved[0, :, :, :2].equal(images[0, :, :, 2:])
    assert moved[1, :, :, :, 3:].equal(images[1, :, :, :, :4])
    assert (moved[1, :, :, :, :3] == images[1, :, :, :, :1]).all()


def test_augmentation_changes_every_observation_of_a_sample_alike():
    torch.manual_seed(0)
    frame = torch.randint(0, 256, (4, 1, 3, 16, 16), dtype=torch.uint8)
    changed = augment(frame.expand(4, 3, 3, 16, 16), AugmentConfig(shift_px=3, brightness=0.3, contrast=0.3))
    assert changed.shape == (4, 3, 3, 16, 16)
    assert changed[:, 0].equal(changed[:, 2])
    assert not changed[0, 0].equal(frame[0, 0].float() / 255)
    assert changed.min() >= 0.0 and changed.max() <= 1.0


def test_augmentation_that_only_shifts_stays_bytes():
    images = torch.zeros(2, 3, 8, 8, dtype=torch.uint8)
    assert augment(images, AugmentConfig(shift_px=1)).dtype is torch.uint8
    assert augment(images, AugmentConfig()) is images


def test_saturation_leaves_grey_images():
    grey = torch.full((2, 3, 8, 8), 128, dtype=torch.uint8)
    torch.testing.assert_close(augment(grey, AugmentConfig(saturation=0.5)), grey.float() / 255)


STRONG = (
    {"hue": 0.2},
    {"convolution": 1.0},
    {"overlay": 0.6},
    {"tone": 1.0},
    {"shadow": 1.0},
    {"swap": 0.9, "swap_camera": "side"},
    {"hue": 0.1, "convolution": 0.5, "overlay": 0.3, "brightness": 0.5, "shift_px": 2},
)


@pytest.mark.parametrize("changes", STRONG, ids=lambda changes: "-".join(changes))
@pytest.mark.parametrize("times", [(), (3,)], ids=["one", "several"])
def test_strong_augmentation_changes_every_observation_of_a_sample_alike(changes, times):
    torch.manual_seed(0)
    frame = torch.randint(0, 256, (4, *[1] * len(times), 3, 16, 20), dtype=torch.uint8)
    images = frame.expand(4, *times, 3, 16, 20)
    changed = augment(images, AugmentConfig(**changes), "side")
    assert changed.shape == images.shape
    assert not changed.equal(images if changed.dtype is torch.uint8 else images.float() / 255)
    if times:
        torch.testing.assert_close(changed[:, 0], changed[:, 2])
    assert changed.min() >= 0 and changed.max() <= (255 if changed.dtype is torch.uint8 else 1)


def test_a_turn_of_the_hue_leaves_grey_and_luma():
    torch.manual_seed(0)
    images = torch.randint(80, 160, (64, 3, 8, 8), dtype=torch.uint8)
    luma = torch.tensor([0.299, 0.587, 0.114]).reshape(3, 1, 1)
    turned = augment(images, AugmentConfig(hue=0.1))
    torch.testing.assert_close((turned * luma).sum(1), (images / 255 * luma).sum(1), atol=1e-3, rtol=0)
    assert (turned - images / 255).abs().mean() > 0.01
    grey = torch.full((2, 3, 8, 8), 128, dtype=torch.uint8)
    torch.testing.assert_close(augment(grey, AugmentConfig(hue=0.5)), grey / 255, atol=1e-3, rtol=0)


def test_a_random_filter_keeps_mean_and_contrast():
    torch.manual_seed(0)
    images = torch.randint(100, 156, (16, 3, 24, 24), dtype=torch.uint8)
    mixed = augment(images, AugmentConfig(convolution=1.0))
    torch.testing.assert_close(mixed.mean((1, 2, 3)), (images / 255).mean((1, 2, 3)), atol=1e-4, rtol=0)
    assert (mixed.std((1, 2, 3)) < 1.01 * (images / 255).std((1, 2, 3))).all()


def test_a_random_tone_moves_equal_luma_alike_and_leaves_chroma():
    torch.manual_seed(0)
    left = torch.tensor([100, 110, 105], dtype=torch.uint8).reshape(1, 3, 1, 1).expand(64, 3, 4, 4)
    right = left + 40
    images = torch.cat([left, right, left], -1)
    moved = augment(images, AugmentConfig(tone=1.0)) - images / 255
    inside = (moved + images / 255 > 0).all(1) & (moved + images / 255 < 1).all(
        1
    )  # not cut off at black or white
    torch.testing.assert_close((moved[:, 0] * inside), (moved[:, 2] * inside), atol=1e-5, rtol=0)
    torch.testing.assert_close(moved[..., :4], moved[..., 8:], atol=1e-6, rtol=0)
    lighter = (images / 255 + moved).mean(1)[:, 0]
    share = (lighter[:, 4] < lighter[:, 0]).float().mean()
    assert 0.25 < share < 0.75, "what was darker is lighter about as often"


def test_random_shadows_darken_a_share_of_the_samples_and_brighten_nothing():
    torch.manual_seed(0)
    images = torch.full((200, 3, 16, 16), 200, dtype=torch.uint8)
    shadowed = augment(images, AugmentConfig(shadow=0.5))
    assert (shadowed <= images / 255).all()
    touched = (shadowed < images / 255 - 0.01).flatten(1).any(1)
    assert 60 < int(touched.sum()) < 140
    assert (shadowed[touched] == 200 / 255).flatten(1).any(1).all(), "some of each image stays"


def test_one_camera_shows_other_samples_in_a_share_of_them():
    torch.manual_seed(0)
    images = torch.arange(200, dtype=torch.uint8).reshape(200, 1, 1, 1).expand(200, 3, 4, 4)
    config = AugmentConfig(swap=0.5)
    assert augment(images, config, "wrist") is images
    swapped = augment(images, config, "front")
    assert swapped.dtype is torch.uint8 and 60 < int((swapped != images)[:, 0, 0, 0].sum()) < 140
    assert (swapped == swapped[:, :1, :1, :1]).all()  # whole images


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": 0}, "train.steps must be above 0, given 0"),
        ({"lr_backbone": -1.0}, "train.lr_backbone must be 0 or more"),
        ({"time_limit_s": 0.0}, "train.time_limit_s must be above 0 seconds"),
        ({"precision": "fp8"}, "train.precision must be one of auto, fp32, bf16, given 'fp8'"),
        ({"schedule": "step"}, "train.schedule must be one of cosine, constant"),
        ({"betas": (0.9, 1.0)}, "train.betas must be two numbers"),
        ({"ema_max_decay": 1.0}, "train.ema_max_decay must be from 0 to below 1"),
    ],
)
def test_train_config_is_checked(changes, message):
    with pytest.raises(ConfigError, match=message):
        TrainConfig(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shift_px": -1}, "augment.shift_px"),
        ({"contrast": 1.0}, "augment.contrast must be from 0"),
        ({"hue": 0.6}, "augment.hue must be from 0 .off. to 0.5, given 0.6"),
        ({"swap": -0.1}, "augment.swap"),
    ],
)
def test_augment_config_is_checked(changes, message):
    with pytest.raises(ConfigError, match=message):
        AugmentConfig(**changes)


def test_devices(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert resolve_device("auto") == "cpu"
    with pytest.raises(ConfigError, match="device='cuda' needs 1 GPU"):
        resolve_device("cuda")
    with pytest.raises(ConfigError, match=r"Unknown device 'tpu'. Valid: auto, cpu, cuda"):
        resolve_device("tpu")


def test_bf16_is_chosen_where_the_processor_has_it(monkeypatch):
    cpu = torch.device("cpu")
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    assert resolve_precision("auto", cpu) == "bf16"
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx2": True})
    assert resolve_precision("auto", cpu) == "fp32"
    assert resolve_precision("bf16", cpu) == "bf16"


def test_threads_are_given_back():
    before = torch.get_num_threads()
    with cpu_threads(before + 1):
        assert torch.get_num_threads() == before + 1
    assert torch.get_num_threads() == before


@pytest.mark.parametrize(
    ("given", "device", "variable", "expected"),
    [
        (3, "cpu", "2", 3),
        (3, "cuda", None, 3),
        (0, "cuda", "2", 1),
        (0, "cpu", "2", 2),
        (0, "cpu", "many", None),
        (0, "cpu", None, None),
    ],
)
def test_threads_are_those_asked_for_or_one_per_core_or_one_beside_a_gpu(
    given, device, variable, expected, monkeypatch
):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if variable is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", variable)
    with cpu_threads(given, device):
        assert torch.get_num_threads() == (expected or len(os.sched_getaffinity(0)))


def test_metrics_of_a_resumed_run_have_no_step_twice(tmp_path):
    writer = JsonlWriter(tmp_path)
    for step in (1, 2, 3):
        writer.write(step, {"loss": float(step)})
    writer.close()
    with (tmp_path / "metrics.jsonl").open("a") as stream:
        stream.write('{"step": 4, "lo')  # killed in the middle of a line
    assert [row["step"] for row in read_metrics(tmp_path)] == [1, 2, 3]
    resumed = JsonlWriter(tmp_path, first_step=2)
    resumed.write(3, {"loss": 30.0})
    resumed.close()
    assert read_metrics(tmp_path)[-1] == {"step": 3, "loss": 30.0}
    assert len(read_metrics(tmp_path)) == 3


def test_progress_reporter_shows_loss_speed_and_time_left():
    console = Console(file=StringIO(), force_terminal=True, width=120)
    reporter = ProgressReporter(console)
    progress = dict(loss=0.1234, samples_per_s=61.2, elapsed_s=9.0, eta_s=3671.0)
    reporter.on_step(Progress(step=50, steps=1000, fraction=0.05, **progress))
    console.print(reporter._progress._bar)
    shown = console.file.getvalue()
    for text in ("50/1,000 (5 %)", "loss 0.1234", "61 samples/s", "1:01:11 left"):
        assert text in shown
