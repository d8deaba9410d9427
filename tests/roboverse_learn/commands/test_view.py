"""``roboverse view``: what is recorded of an episode, and its errors."""

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from envs.core.errors import ConfigError, MissingExtraError
from envs.spec import EnvSpec
from roboverse_learn import cli
from roboverse_learn.config.compose import compose
from roboverse_learn.view import has_display, view


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
    with pytest.raises(MissingExtraError, match=r"pip install 'roboverse-learn\[viewer\]'"):
        view(compose("view", []))


def test_display_is_found_by_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not has_display()
    monkeypatch.setenv("DISPLAY", ":0")
    assert has_display()


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


@pytest.mark.slow
def test_recording_holds_scene_images_and_draws_over_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun", reason="the extra viewer is not installed")
    from rerun.recording import load_recording  # pyright: ignore[reportMissingImports]

    file = tmp_path / "episode.rrd"
    assert cli.main(["view", "task=PickCube", "level=3", "image_size=32", f"file={file}"]) == 0
    assert f"rerun {file}" in capsys.readouterr().out
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        schema = load_recording(file).schema()
    paths = {column.entity_path for column in schema.component_columns()}
    assert {"/draws", "/scene/cameras/front", "/scene/cameras/wrist", "/scene/cube"} <= paths
    assert any(path.startswith("/scene/franka.") for path in paths)
    assert "time" in {column.name for column in schema.index_columns()}
