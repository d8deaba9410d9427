import math

import av
import numpy as np
import pytest
from PIL import Image

from benchmark.leaderboard import plots
from benchmark.leaderboard.plots import plot_learning, plot_levels, plot_losses
from benchmark.runner import evaluate_cell
from benchmark.videos import choose_episodes, film_cell, record_episode, write_video
from envs.core.errors import WriteError
from envs.spec import EnvSpec

MEASURE = {"mid": [0.0, 0.5], "low": None, "high": None}


@pytest.fixture
def cell_records(point_env, noisy_policy):
    episodes = list(range(100, 112))
    return evaluate_cell(
        noisy_policy(), point_env(4), episodes, split="test", level=1, seed=0, policy_name="noisy"
    )


@pytest.mark.parametrize("every", [1, 2, 3, 4])
def test_video_spans_the_first_to_the_last_step(point_env, noisy_policy, cell_records, every):
    for record in cell_records[:4]:
        frames, success = record_episode(noisy_policy(), point_env(4), record.episode, seed=0, every=every)
        assert success is record.success
        assert len(frames) == 1 + math.ceil(record.length / every)
        assert (frames[0, 0, 0, 0], frames[-1, 0, 0, 0]) == (0, record.length * 10)


def test_first_failure_and_first_success_are_chosen(cell_records):
    chosen = choose_episodes(cell_records)
    assert [record.success for record in chosen] == [False, True]
    assert chosen[0] == next(record for record in cell_records if not record.success)


def test_videos_of_a_cell_are_named_by_episode_and_outcome(point_env, noisy_policy, cell_records, tmp_path):
    paths = film_cell(noisy_policy(), point_env(4), cell_records, tmp_path, control_hz=20.0)
    failure, success = choose_episodes(cell_records)
    assert [path.name for path in paths] == [
        f"level1-test-{failure.episode}-failure.mp4",
        f"level1-test-{success.episode}-success.mp4",
    ]
    with av.open(str(paths[0])) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.width, stream.average_rate) == ("h264", 16, 10)
        assert sum(1 for _ in container.decode(stream)) == 13


def test_video_keeps_the_image(tmp_path):
    frames = np.zeros((6, 33, 47, 3), np.uint8)
    frames[:, :, :, 1] = np.arange(6)[:, None, None] * 40
    write_video(tmp_path / "a.mp4", frames, 10)
    container = av.open(str(tmp_path / "a.mp4"))
    decoded = np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])
    container.close()
    assert decoded.shape == (6, 32, 46, 3)
    assert np.abs(decoded.astype(int) - frames[:, :32, :46]).mean() < 4
    assert np.array_equal(np.asarray(Image.open(tmp_path / "a.png")), frames[-1])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "a.png"]


@pytest.mark.slow
def test_the_same_frames_are_the_same_bytes(tmp_path):
    env = EnvSpec(task="PickCube", cameras=("front",), image_size=32).make(1)
    env.reset(seed=0)
    rng, frames = np.random.default_rng(0), []
    for _ in range(50):
        env.step(rng.uniform(env.action_space.low, env.action_space.high))
        frames.append(np.array(env.image(0)))
    written = set()
    for _ in range(20):
        write_video(tmp_path / "a.mp4", np.stack(frames), 10.0)
        written.add((tmp_path / "a.mp4").read_bytes())
    assert len(written) == 1


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match=r"'.*/file' is a file, not a folder\. Name another"):
        write_video(tmp_path / "file" / "a.mp4", np.zeros((2, 16, 16, 3), np.uint8), 10)


def test_level_curves(tmp_path):
    cells = [
        {
            "level": level,
            "only": None,
            "split": split,
            "success_rate": rate,
            "ci_low": rate - 0.1,
            "ci_high": rate + 0.1,
        }
        for split in ("train", "test")
        for level, rate in enumerate((0.9, 0.7, 0.4, 0.2))
    ]
    plot_levels(
        [{"label": "act", "cells": cells}, {"label": "diffusion", "cells": cells}], tmp_path / "l.png"
    )
    image = np.asarray(Image.open(tmp_path / "l.png").convert("RGB"))
    assert image.shape[1] > 900
    assert (np.abs(image.astype(int) - (0x00, 0x72, 0xB2)).max(axis=2) < 8).sum() > 500


@pytest.mark.parametrize(("level", "expected"), [(1, ["act", "same, train split"]), (None, ["act"])])
def test_the_legend_names_the_train_split_where_a_row_has_it(monkeypatch, tmp_path, level, expected):
    figures = []
    monkeypatch.setattr(plots, "save_figure", lambda figure, *_: figures.append(figure))
    cell = {"only": None, "success_rate": 0.5, "ci_low": 0.4, "ci_high": 0.6}
    cells = [cell | {"split": "test", "level": 1}, cell | {"split": "train", "level": level}]
    plot_levels([{"label": "act", "cells": cells}], tmp_path / "l.png")
    assert sorted(text.get_text() for text in figures[0].legends[0].get_texts()) == expected


def test_eight_lines_look_different_and_nine_are_refused(monkeypatch, tmp_path):
    figures = []
    monkeypatch.setattr(plots, "save_figure", lambda figure, *_: figures.append(figure))
    cells = [
        {"level": level, "only": None, "split": "test", "success_rate": 0.5, "ci_low": 0.4, "ci_high": 0.6}
        for level in (0, 1)
    ]
    rows = [{"label": str(number), "cells": cells} for number in range(9)]
    plot_levels(rows[:8], tmp_path / "l.png")
    lines = [line for line in figures[0].axes[0].get_lines() if line.get_linestyle() != "None"]
    assert len({(line.get_color(), line.get_marker()) for line in lines}) == len(lines) == 8
    with pytest.raises(ValueError, match="at most 8 lines, given 9"):
        plot_levels(rows, tmp_path / "l.png")


def test_loss_curves(tmp_path):
    rows = [{"step": step, "loss": math.exp(-step / 50), "lr": 1.0} for step in range(200)]
    rows[3]["kl_loss"] = 0.5
    plot_losses(rows, tmp_path / "loss.png")
    with Image.open(tmp_path / "loss.png") as image:
        assert image.size[0] > 900
    with pytest.raises(ValueError, match="no row has a key with 'loss'"):
        plot_losses([{"step": 1, "lr": 1.0}], tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


def label(words):
    return f"ppo by torchrl, {', '.join(['trained in mujoco_warp'] * words)}, rendered with warp"


def overlap(figure):
    """How far, in pixels, the legend reaches beyond the image or into what is above it."""
    figure.draw_without_rendering()
    legend, image = figure.legends[0].get_window_extent(), figure.bbox
    axes = min(each.get_tightbbox().y0 for each in figure.axes)
    return max(image.x0 - legend.x0, legend.x1 - image.x1, image.y0 - legend.y0, legend.y1 - axes)


@pytest.mark.slow
@pytest.mark.parametrize("labels", [["act"], [label(1)] * 3, [label(1)] * 8, [label(9)] * 4, ["x" * 300]])
def test_legend_is_within_the_image(monkeypatch, tmp_path, labels):
    figures = []
    monkeypatch.setattr(plots, "save_figure", lambda figure, *_: figures.append(figure))
    cell = {"split": "test", "level": 0, "only": None, "success_rate": 0.5, "ci_low": 0.4, "ci_high": 0.6}
    plot_levels([{"label": text, "cells": [cell]} for text in labels], tmp_path / "l.png")
    curve = {"steps": [1, 2], "seconds": [1, 2], "episode_return": MEASURE, "success_rate": MEASURE}
    curves = [curve | {"label": text, "row": row, "seeds": [0]} for row, text in enumerate(labels)]
    plot_learning(curves, tmp_path / "c.png")
    for figure in figures:
        assert overlap(figure) <= 0
        # All of the names, whatever the lines that they are broken into.
        shown = ["".join(text.get_text().split()) for text in figure.legends[0].get_texts()]
        assert all(name.startswith("".join(text.split())) for name, text in zip(shown, labels, strict=True))
        assert figure.axes[0].get_position().height * figure.get_figheight() > 2.0, "an image is left, inch"
