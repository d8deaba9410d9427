"""Schedules, averages, augmentation and metrics against numbers worked out by hand."""

import json
import math
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import policies
from envs.core.errors import ConfigError
from roboverse_learn.training.config import AugmentConfig, TrainConfig
from roboverse_learn.training.imitation.ema import Ema
from roboverse_learn.training.imitation.image_augmentation import augment, shift
from roboverse_learn.training.imitation.optimizer import make_optimizer
from roboverse_learn.training.imitation.schedule import learning_rate_factor, progress
from roboverse_learn.training.metrics import JsonlWriter, WandbWriter, check_wandb, read_metrics
from roboverse_learn.training.randomness import step_seed
from tests.policies.examples import CONFIGS, FEATURES, stats


class TestLearningRate:
    def test_a_whole_cosine_with_warm_up(self):
        config = TrainConfig(steps=8, warmup_steps=4)
        warmup = [0.25, 0.5, 0.75, 1.0, 1.0, 1.0, 1.0, 1.0]
        cosine = [0.5 * (1 + math.cos(math.pi * step / 8)) for step in range(8)]
        expected = [first * second for first, second in zip(warmup, cosine, strict=True)]
        assert [learning_rate_factor(config, step, 0.0) for step in range(8)] == pytest.approx(expected)
        assert expected[4] == pytest.approx(0.5)
        assert expected[1] == pytest.approx(0.5 * 0.9619398)

    @given(
        steps=st.integers(1, 500), warmup=st.integers(0, 100), share=st.floats(0, 1), speed=st.floats(0.01, 2)
    )
    def test_after_the_warm_up_it_only_falls(self, steps, warmup, share, speed):
        config = TrainConfig(steps=steps, warmup_steps=warmup, time_limit_s=50.0)
        factors = [learning_rate_factor(config, step, speed * step) for step in range(steps)]
        assert all(0.0 <= factor <= 1.0 for factor in factors)
        late = factors[warmup:]
        assert late == sorted(late, reverse=True)

    @given(step=st.integers(0, 1000), elapsed=st.floats(0, 200))
    def test_the_time_limit_ends_the_cosine_wherever_the_steps_are(self, step, elapsed):
        config = TrainConfig(steps=1000, warmup_steps=0, time_limit_s=100.0)
        done = progress(config, step, elapsed)
        assert done == pytest.approx(min(1.0, max(step / 1000, elapsed / 100)))
        if elapsed >= 100:
            assert learning_rate_factor(config, step, elapsed) == pytest.approx(0.0, abs=1e-12)
        without = replace(config, time_limit_s=None)
        assert (
            learning_rate_factor(config, step, elapsed)
            <= learning_rate_factor(without, step, elapsed) + 1e-12
        )

    def test_a_constant_schedule_does_not_look_at_the_clock(self):
        config = TrainConfig(steps=10, warmup_steps=2, schedule="constant", time_limit_s=1.0)
        assert [learning_rate_factor(config, step, 100.0) for step in (0, 1, 9)] == [0.5, 1.0, 1.0]

    def test_the_backbone_has_a_rate_of_its_own(self):
        policy = policies.create("act", FEATURES, stats(), CONFIGS["act"])
        names = {id(p): name for name, p in policy.model.named_parameters()}
        main, backbone = make_optimizer(policy, TrainConfig(lr=1e-3, lr_backbone=1e-5)).param_groups
        assert (main["peak_lr"], backbone["peak_lr"]) == (1e-3, 1e-5)
        assert all("backbone" in names[id(p)] for p in backbone["params"])
        assert not any("backbone" in names[id(p)] for p in main["params"])
        trainable = [p for p in policy.model.parameters() if p.requires_grad]
        assert len(main["params"]) + len(backbone["params"]) == len(trainable)


class TestEma:
    def test_the_warm_up_of_the_decay(self):
        """1 - (1 + t)^-0.75 by hand; 0 at first, so that the first weights count in full."""
        ema = Ema({"w": torch.zeros(1)}, power=0.75, max_decay=0.8)
        decays = []
        for value in (4.0, 8.0, 8.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0):
            decays.append(ema.decay())
            ema.update({"w": torch.tensor([value])})
        assert decays[:4] == pytest.approx([0.0, 0.4053964, 0.5613087, 0.6464466], abs=1e-6)
        assert decays[-1] == 0.8  # 1 - 9^-0.75 = 0.808
        assert decays == sorted(decays)

    def test_three_updates_worked_out(self):
        ema = Ema({"w": torch.tensor([100.0])}, power=0.75, max_decay=0.9999)
        for value in (4.0, 8.0, 2.0):
            ema.update({"w": torch.tensor([value])})
        second = 0.4053964 * 4.0 + 0.5946036 * 8.0
        assert ema.average["w"].item() == pytest.approx(0.5613087 * second + 0.4386913 * 2.0, rel=1e-6)

    @given(values=st.lists(st.floats(-10, 10), min_size=1, max_size=30), power=st.floats(0.1, 2.0))
    def test_an_average_lies_among_what_it_is_of(self, values, power):
        ema = Ema({"w": torch.tensor(1e9)}, power=power, max_decay=0.999)
        for value in values:
            ema.update({"w": torch.tensor(value)})
        # The first update replaces what was there, up to the last bits of 1e9.
        assert min(values) - 1e-3 <= ema.average["w"].item() <= max(values) + 1e-3

    def test_going_on_with_the_count_is_never_having_stopped(self):
        values = [torch.tensor([float(v)]) for v in (3, 1, 4, 1, 5, 9)]
        whole = Ema({"w": torch.zeros(1)}, 0.75, 0.99)
        for value in values[:3]:
            whole.update({"w": value})
        resumed = Ema(whole.average, 0.75, 0.99, num_updates=whole.num_updates)
        for value in values[3:]:
            whole.update({"w": value})
            resumed.update({"w": value})
        assert whole.average["w"].equal(resumed.average["w"])


class TestAugmentation:
    @given(row=st.integers(-3, 3), column=st.integers(-3, 3))
    def test_a_shift_is_numpys_edge_padding_and_a_crop(self, row, column):
        images = torch.arange(2 * 3 * 5 * 4, dtype=torch.uint8).reshape(2, 3, 5, 4)
        moved = shift(images, torch.tensor([[row, column], [0, 0]]))
        padded = np.pad(images[0].numpy(), ((0, 0), (3, 3), (3, 3)), mode="edge")
        expected = padded[:, 3 + row : 8 + row, 3 + column : 7 + column]
        np.testing.assert_array_equal(moved[0].numpy(), expected)
        assert moved[1].equal(images[1])

    def test_brightness_multiplies_every_pixel_of_a_sample_alike(self):
        images = torch.tensor([50, 100, 200], dtype=torch.uint8).reshape(1, 1, 1, 3).expand(6, 3, 1, 3)
        torch.manual_seed(3)
        factors = 1 + 0.2 * (2 * torch.rand(6) - 1)
        torch.manual_seed(3)
        changed = augment(images, AugmentConfig(brightness=0.2))
        expected = torch.tensor([50, 100, 200]) / 255 * factors[:, None]
        torch.testing.assert_close(changed[:, 1, 0], expected.clamp(max=1.0))
        assert len({round(float(factor), 6) for factor in factors}) == 6

    def test_contrast_keeps_the_mean_grey_and_scales_about_it(self):
        images = torch.full((4, 3, 2, 2), 100, dtype=torch.uint8)
        images[..., 0, 0] = 140
        torch.manual_seed(0)
        changed = augment(images, AugmentConfig(contrast=0.5))
        torch.testing.assert_close(changed.mean(dim=(1, 2, 3)), torch.full((4,), 110 / 255))
        torch.manual_seed(0)
        factors = 1 + 0.5 * (2 * torch.rand(4) - 1)
        torch.testing.assert_close(changed[:, 0, 0, 0], (110 + 30 * factors) / 255)

    def test_saturation_moves_along_the_line_to_the_luma(self):
        images = torch.tensor([200, 100, 0], dtype=torch.uint8).reshape(1, 3, 1, 1)
        torch.manual_seed(1)
        factor = 1 + 0.4 * (2 * torch.rand(1) - 1)
        torch.manual_seed(1)
        changed = augment(images, AugmentConfig(saturation=0.4)).ravel()
        luma = 0.299 * 200 + 0.587 * 100
        expected = (luma + factor * (torch.tensor([200.0, 100.0, 0.0]) - luma)) / 255
        torch.testing.assert_close(changed, expected.clamp(0, 1))

    def test_brightness_contrast_saturation_and_hue_follow_each_other(self):
        images = torch.randint(90, 160, (3, 3, 2, 5), dtype=torch.uint8)  # nothing is clamped
        strengths = {"brightness": 0.2, "contrast": 0.3, "saturation": 0.4, "hue": 0.05}
        torch.manual_seed(4)
        changed = augment(images, AugmentConfig(**strengths))
        torch.manual_seed(4)
        brightness, contrast, saturation = (1 + s * (2 * torch.rand(3) - 1) for s in (0.2, 0.3, 0.4))
        angles = 2 * np.pi * 0.05 * (2 * torch.rand(3) - 1)
        luma = np.array([0.299, 0.587, 0.114])
        yiq = np.array([luma, [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])
        for i in range(3):
            pixels = images[i].numpy().reshape(3, -1) / 255 * float(brightness[i])
            mean = (luma @ pixels).mean()
            pixels = mean + (pixels - mean) * float(contrast[i])
            grey = luma @ pixels
            pixels = grey + (pixels - grey) * float(saturation[i])
            y, chroma_i, chroma_q = yiq @ pixels
            cos, sin = np.cos(float(angles[i])), np.sin(float(angles[i]))
            turned = np.stack([y, cos * chroma_i - sin * chroma_q, sin * chroma_i + cos * chroma_q])
            expected = np.linalg.solve(yiq, turned).reshape(3, 2, 5)
            np.testing.assert_allclose(changed[i].numpy(), expected, atol=1e-5)

    @pytest.mark.parametrize("step", [0, 7])
    def test_a_step_draws_the_same_whatever_came_before(self, step):
        config = AugmentConfig(shift_px=2, brightness=0.3, contrast=0.2, saturation=0.2)
        images = torch.randint(0, 256, (4, 3, 8, 8), dtype=torch.uint8)
        drawn = []
        for before in (0, 5):
            torch.rand(before)
            torch.manual_seed(step_seed(11, step, 0))
            drawn.append(augment(images, config))
        assert drawn[0].equal(drawn[1])
        torch.manual_seed(step_seed(11, step + 1, 0))
        assert not augment(images, config).equal(drawn[0])
        torch.manual_seed(step_seed(11, step, 1))  # another process sees other changes
        assert not augment(images, config).equal(drawn[0])

    def test_the_batch_given_is_not_changed(self):
        images = torch.randint(0, 256, (2, 3, 8, 8), dtype=torch.uint8)
        before = images.clone()
        augment(images, AugmentConfig(shift_px=2, brightness=0.3, contrast=0.3, saturation=0.3))
        assert images.equal(before)


class TestMetrics:
    def write(self, folder, steps, first_step=0):
        writer = JsonlWriter(folder, first_step)
        for step in steps:
            writer.write(step, {"loss": 1.0 / step})
        writer.close()

    @pytest.mark.slow
    @given(kept=st.integers(0, 200))
    @settings(deadline=None)
    def test_a_file_cut_off_anywhere_reads_to_its_last_whole_line(self, tmp_path_factory, kept):
        folder = tmp_path_factory.mktemp("metrics")
        self.write(folder, range(1, 8))
        path = folder / "metrics.jsonl"
        content = path.read_bytes()
        path.write_bytes(content[:kept])
        rows = read_metrics(folder)
        assert [row["step"] for row in rows] == list(range(1, len(rows) + 1))
        lines = content[:kept].split(b"\n")
        whole = len(lines) - 1 + (lines[-1].endswith(b"}"))
        assert len(rows) == whole

    def test_going_on_removes_the_torn_line_and_what_will_come_again(self, tmp_path):
        self.write(tmp_path, range(1, 8))
        with (tmp_path / "metrics.jsonl").open("a") as stream:
            stream.write('{"step": 8, "loss": 0.1')
        self.write(tmp_path, (5, 6), first_step=4)
        lines = (tmp_path / "metrics.jsonl").read_text().splitlines()
        assert [json.loads(line)["step"] for line in lines] == [1, 2, 3, 4, 5, 6]
        assert [path.name for path in tmp_path.iterdir()] == ["metrics.jsonl"]

    def test_a_run_without_metrics_has_no_rows(self, tmp_path):
        assert read_metrics(tmp_path) == []


class TestWandbWithoutALogin:
    @pytest.fixture(autouse=True)
    def logged_out(self, monkeypatch):
        """The package where no key is configured: whatever needs one fails."""

        class Error(Exception):
            pass

        def fail(**_):
            raise Error("No API key configured.")

        monkeypatch.setitem(sys.modules, "wandb", SimpleNamespace(Error=Error, init=fail, login=fail))
        monkeypatch.delenv("WANDB_MODE", raising=False)

    @pytest.mark.parametrize("start", [lambda folder: WandbWriter(folder, {}), lambda _: check_wandb()])
    def test_the_message_says_what_to_do(self, tmp_path, start):
        with pytest.raises(ConfigError, match=r"No API key .*`wandb login`.*WANDB_MODE=offline.*wandb=false"):
            start(tmp_path)

    @pytest.mark.parametrize("mode", ["offline", "disabled", "dryrun"])
    def test_nothing_is_asked_of_a_run_that_needs_no_login(self, mode, monkeypatch):
        monkeypatch.setenv("WANDB_MODE", mode)
        check_wandb()
