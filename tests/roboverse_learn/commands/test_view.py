"""``roboverse view``: what is recorded of an episode, and its errors."""

import os
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from envs.core.errors import ConfigError, DatasetError, MissingExtraError
from envs.core.extras import install_command
from envs.spec import EnvSpec
from roboverse_learn.config.compose import compose
from roboverse_learn.view import has_display, view
from roboverse_learn.viewer import episodes
from tests.imported_process import start
from tests.viewed import needs_viewer, recorded
from tests.viewed import view as run_view


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["dataset=a", "result=b"], "dataset=a and result=b cannot be combined"),
        (["dataset=a", "level=3"], "dataset=a cannot be combined"),
        (["file=out.mp4"], "file=out.mp4 must end in .rrd"),
        (["episode=-1"], "episode must be 0 or more"),
    ],
)
def test_keys_that_exclude_each_other_are_refused(words: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        compose("view", words)


def test_absent_library_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=re.escape(install_command("viewer"))):
        view(compose("view", []))


def test_display_is_found_by_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not has_display()
    monkeypatch.setenv("DISPLAY", ":0")
    assert has_display()


@pytest.fixture
def result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns the file of a result with one video, evaluated with a folder of materials."""
    record = SimpleNamespace(
        cell=SimpleNamespace(name="level2-test"), episode=3, level=2, only=None, split="train", seed=0,
        instruction=None, policy="act", success=True, switched_to=None,
    )  # fmt: skip
    found = SimpleNamespace(
        env=EnvSpec(task="PickCube", image_size=32, materials="+my-images-1a2b3c4d"),
        records=[record],
        run="run",
    )
    (tmp_path / "run").mkdir()
    (tmp_path / "run/level2-test-3-success.mp4").touch()
    monkeypatch.setattr("benchmark.results.read_result", lambda _: found)
    monkeypatch.setattr(episodes, "_video", lambda _: ([np.zeros((32, 32, 3), np.uint8)], 20.0))
    return tmp_path / "run.json"


class Recorded:
    """Takes what is recorded, in place of the viewer's library."""

    def __init__(self, env: Any, title: str) -> None:
        self.env, self.title, self.text = env, title, ""

    def start(self, text: str) -> None:
        self.text = text

    def add(self, *_: Any) -> None:
        pass


def test_a_result_is_viewed_with_the_materials_that_are_given(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(episodes, "EpisodeRecording", Recorded)
    images = tmp_path / "my-images"
    images.mkdir()
    for number in range(4):
        Image.new("RGB", (16, 16), (60 * number, 100, 200)).save(images / f"{number}.png")
    config = compose("view", [f"result={result}", f"materials=+{images}"])
    shown: Any = episodes.record_result(config)
    assert shown.env.env_spec.materials == f"+{images}" and shown.env.env_spec.level == 2
    assert "# PickCube, level 2" in shown.text


def test_a_result_with_materials_says_to_add_them(result: Path) -> None:
    with pytest.raises(ConfigError, match=r"'\+my-images-1a2b3c4d', .*materials=\+<path .* 'my-images'>"):
        episodes.record_result(compose("view", [f"result={result}"]))


def test_of_a_dataset_the_viewed_episode_alone_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    read = []

    def absent(_: object, episode: int) -> None:
        read.append(episode)
        raise DatasetError("no raw states")

    info = SimpleNamespace(root="data", num_episodes=9, read_columns=lambda keys: dict.fromkeys(keys))
    monkeypatch.setattr("roboverse_learn.data.dataset.info.DatasetInfo.open", lambda _: info)
    monkeypatch.setattr("roboverse_learn.data.dataset.recording.read_raw", absent)
    with pytest.raises(DatasetError, match="no raw states"):
        episodes.record_dataset(compose("view", ["dataset=data", "episode=7"]))
    assert read == [7]


@pytest.mark.slow
def test_visual_geoms_become_meshes_with_the_materials_of_the_level() -> None:
    from envs.randomization import MaterialLibrary, Randomizer
    from envs.simulators.hybrid import make_handler
    from envs.simulators.mujoco.render import Stage
    from roboverse_learn.viewer.geometry import visible_meshes

    scenario = EnvSpec(task="PickCube").make_task().scenario
    library = MaterialLibrary.chosen("")
    channels = EnvSpec(level=3).channels
    drawn = Randomizer(
        scenario.appearance, scenario.cameras, channels=channels, split="train", seed=0, library=library,
        scenario=scenario,
    )  # fmt: skip
    appearance = drawn.appearance(int(drawn.split.episodes[0]))
    handler = make_handler("mujoco", scenario, 1, renderer="warp", textures=library.texture)
    handler.launch()
    stage = Stage(handler.model, scenario)  # pyright: ignore[reportAttributeAccessIssue]
    handler.set_appearance(appearance, 0)
    stage.pose(handler.snapshot()[0])
    meshes = list(visible_meshes(stage, scenario, appearance, library.texture))
    handler.close()
    assert {stage.model.body(int(stage.model.geom_bodyid[mesh.geom])).name for mesh in meshes} >= {"cube"}
    assert sum(mesh.texture is not None for mesh in meshes) >= 3
    for mesh in meshes:
        assert mesh.triangles.max() < len(mesh.vertices) == len(mesh.normals)
        assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-3)


SERVE = """
from contextlib import closing
from types import SimpleNamespace
from envs.spec import EnvSpec
from roboverse_learn.viewer.recording import EpisodeRecording

asked = []
with closing(EnvSpec(task="PickCube", cameras=("front",), image_size=16).make(1)) as env:
    recording = EpisodeRecording(env, "a title")
    recording._stream = SimpleNamespace(
        serve_grpc=lambda **words: asked.append(sorted(words)) or "rerun+http://here",
        send_blueprint=lambda views: asked.append(type(views).__name__),
    )
    recording._calls = [lambda: asked.append("logged")]
    recording._rr = SimpleNamespace(serve_web_viewer=lambda **words: asked.append(words["connect_to"]))
    page = recording.serve()
print(asked, page.partition("?")[2])
"""


@pytest.mark.slow
@needs_viewer
def test_the_server_has_started_before_it_gets_a_blueprint_or_anything_else(tmp_path: Path) -> None:
    out = tmp_path / "printed"
    process = start(SERVE, folder=tmp_path, out=out)
    process.join(300)
    assert process.exitcode == 0, out.read_text()
    expected = "[['grpc_port'], 'Blueprint', 'logged', 'rerun+http://here'] url=rerun%2Bhttp%3A%2F%2Fhere"
    assert out.read_text().splitlines()[-1] == expected


@pytest.mark.slow
@needs_viewer
def test_recording_holds_scene_images_and_draws_over_time(tmp_path: Path) -> None:
    words = ("task=PickCube", "level=3", "image_size=32", "file=episode.rrd")
    assert "rerun episode.rrd" in run_view(*words, folder=tmp_path, env=dict(os.environ))
    found = recorded(tmp_path / "episode.rrd")
    paths = set(found["paths"].tolist())
    assert {"/draws", "/scene/cameras/front", "/scene/cameras/wrist", "/scene/cube"} <= paths
    assert any(path.startswith("/scene/franka.") for path in paths)
    assert len(found["times"]) > 10 and (np.diff(found["times"]) > 0).all()
