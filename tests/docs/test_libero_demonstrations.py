"""Demonstrations for LIBERO's own environment: what of it runs here."""

import numpy as np
import pytest
import torch

from docs.generate import libero_demonstrations as script
from envs.spec import EnvSpec
from envs.tasks.libero import task as libero_task
from envs.tasks.libero.catalogue import entries
from envs.tasks.libero.files import start_file
from envs.tasks.libero.starts import starts_of
from envs.tasks.libero_objects import read_init_states
from tests.robot_files import needs_files_of_task

WIDTH = 79
"""Numbers of a start of this task."""


@pytest.fixture
def forget():
    """Forgets the starts that other tests have, and those of a test when it is over."""

    def forget():
        starts_of.cache_clear()
        libero_task._after_waiting.cache_clear()

    forget()
    yield forget
    forget()


@pytest.mark.slow
def test_actions_solve_the_task_from_the_starts_that_were_given(tmp_path, forget):
    needs_files_of_task(script.TASK)
    entry = entries()[script.TASK]
    rows = read_init_states(start_file(entry), WIDTH)[[7, 3]]
    np.save(tmp_path / "starts.npy", rows)
    script.actions(str(tmp_path / "starts.npy"), str(tmp_path / "actions.npz"))
    given = starts_of(entry).fixed
    forget()
    own = starts_of(entry).fixed.select([7, 3])
    for name in own.objects:
        torch.testing.assert_close(given.objects[name].pos, own.objects[name].pos)
    native = {"action_space": "native", "observation_space": "native", "starts": "libero"}
    with np.load(tmp_path / "actions.npz") as found:
        assert found.files == ["0", "1"]
        env = EnvSpec(task=script.TASK, task_kwargs=native).make(1, num_threads=1)
        for number, start in (("0", 7), ("1", 3)):
            assert found[number].shape[1] == len(script.ACTION) and np.abs(found[number]).max() <= 1.0
            env.reset_envs(np.array([0]), env.split_indices[start : start + 1])
            solved = [env.step_envs(np.array([0]), action[None])[3][0] for action in found[number]]
            assert solved[-1] and not solved[0]
        env.close()


def test_a_frame_has_the_features_of_the_dataset():
    class Original:
        task_description = "turn on the stove"

    image = np.linspace(0.0, 1.0, 3 * script.PX**2, dtype=np.float32).reshape(1, 3, script.PX, script.PX)
    seen = {f"observation.images.{name}": torch.from_numpy(image) for name in script.IMAGES}
    seen["observation.state"] = torch.arange(8.0)[None]
    values = script.frame(seen, np.ones(7, np.float32), Original())
    assert values.pop("task") == "turn on the stove"
    features = script.features()
    assert values.keys() == features.keys()
    for key, feature in features.items():
        assert values[key].shape == feature["shape"]
    assert values["observation.images.image"][0, 0].tolist() == [0, 85, 170]  # channels last, of 255
    assert values["observation.state"].tolist() == list(range(8))
