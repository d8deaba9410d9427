"""A file or a material that a changed scene names and that is not there, told before anything is written."""

from pathlib import Path

import pytest
from PIL import Image

from envs.errors import ConfigError
from policies.checkpoint import CONFIG, WEIGHTS
from roboverse_learn import cli
from roboverse_learn.scenario_files import check_scenario_files

TEXTURE = "scenario.appearance.materials.table.texture"
ROBOT = "scenario.robots.franka.mjcf"
TABLE = {"appearance": {"materials": {"table": {"texture": "table.png"}}}}


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    folder = tmp_path / "pictures"
    folder.mkdir()
    for name in ("table.png", "a.png", "b.png", "c.png"):
        Image.new("RGB", (16, 16), (200, 100, 50)).save(folder / name)
    return folder


@pytest.mark.parametrize(
    ("words", "materials"),
    [
        ("collect", "materials"),
        ("collect num_workers=2", "materials"),
        ("train policy=act", "materials"),
        ("train policy=ppo", "evaluate.materials"),
        ("evaluate checkpoint=checkpoint task=PickCube image_size=32", "evaluate.materials"),
    ],
)
@pytest.mark.parametrize(
    ("word", "said"),
    [
        (
            f"{ROBOT}=no.xml",
            f"error: {ROBOT}=no.xml: give the path of a file, or package:path for one inside an installed "
            "package. The asset 'no.xml' does not exist: there is no file /",
        ),
        (
            f"{TEXTURE}=no.png",
            f"error: {TEXTURE}=no.png: give the name of a material, or of a picture in the folder that "
            "{materials}=+<folder> adds. Unknown material family 'no.png'. Valid: asphalt, ",
        ),
    ],
)
def test_nothing_is_left_behind(
    words: str,
    materials: str,
    word: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    if words.startswith("evaluate"):
        (tmp_path / "checkpoint").mkdir()
        (tmp_path / "checkpoint" / CONFIG).write_text('{"type": "act", "input_features": {}}')
        (tmp_path / "checkpoint" / WEIGHTS).touch()
    before = sorted(tmp_path.rglob("*"))
    assert cli.main([*words.split(), "preset=quick", word]) == 2
    assert capsys.readouterr().err.startswith(said.format(materials=materials))
    assert sorted(tmp_path.rglob("*")) == before


def test_what_is_there_is_taken(tmp_path: Path, pictures: Path) -> None:
    file = tmp_path / "robot.xml"
    file.touch()
    check_scenario_files("PickCube", {}, {"robots": {"franka": {"mjcf": str(file)}}}, {})
    check_scenario_files("PickCube", {}, TABLE, {"materials": f"+{pictures}"})
    wood = {"appearance": {"materials": {"table": {"texture": "wood-017"}}}}
    check_scenario_files("PickCube", {}, wood, {"materials": ""})


def test_every_library_must_know_a_material(pictures: Path) -> None:
    both = {"materials": f"+{pictures}", "evaluate.materials": ""}
    with pytest.raises(
        ConfigError,
        match=rf"^{TEXTURE}=table\.png: .* evaluate\.materials=\+<folder> adds\. Unknown material",
    ):
        check_scenario_files("PickCube", {}, TABLE, both)
    (pictures / "table.png").rename(pictures / "tables.png")
    with pytest.raises(ConfigError, match=r"Unknown material 'table\.png'\. Did you mean 'tables\.png'\?"):
        check_scenario_files("PickCube", {}, TABLE, {"materials": f"+{pictures}"})
