"""A missing file or material of a changed scene is reported before anything is written."""

from pathlib import Path

import pytest
from PIL import Image

from envs.core.assets import resolve
from envs.core.errors import ConfigError, DatasetError, ResultError
from envs.spec import EnvSpec
from envs.tasks.pick_cube import PickCube
from policies.checkpoint import CONFIG, WEIGHTS
from roboverse_learn import cli
from roboverse_learn.config.compose import compose
from roboverse_learn.config.preflight import check_folders, check_scenario_files
from roboverse_learn.data import DatasetWriter

TEXTURE = "scenario.appearance.materials.table.texture"
ROBOT = "scenario.robots.franka.mjcf"
TABLE = {"appearance": {"materials": {"table": {"texture": "table.png"}}}}


@pytest.fixture
def images(tmp_path: Path) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    for name in ("table.png", "a.png", "b.png", "c.png"):
        Image.new("RGB", (16, 16), (200, 100, 50)).save(folder / name)
    return folder


@pytest.mark.slow
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
            f"error: {TEXTURE}=no.png: give the name of a material, or of an image in the folder that "
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


@pytest.mark.parametrize("command", ["collect", "train policy=act", "train policy=ppo"])
def test_a_broken_file_leaves_nothing_behind(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.xml").write_text("<mujoco>\n<worldbody></mujoco>")
    assert cli.main([*command.split(), "preset=quick", f"{ROBOT}=broken.xml"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(
        f"error: {ROBOT}=broken.xml: no scene can be made of it. 'broken.xml' is no MJCF file: XML parse"
    )
    assert said.endswith("Give a file that fits the rest of the scene, or change that, too.\n")
    assert [path.name for path in tmp_path.rglob("*")] == ["broken.xml"]


@pytest.mark.slow
def test_unsuitable_file_error_names_what_is_missing(tmp_path: Path) -> None:
    other = tmp_path / "other.xml"
    other.write_text('<mujoco><worldbody><body name="trunk"/></worldbody></mujoco>')
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    flat = {"shape": "mesh", "mesh": str(tmp_path / "flat.obj")}
    for changes, reason in (
        ({"robots": {"franka": {"mjcf": str(other)}}}, r"Unknown root of '.*other.xml' 'base'. Valid: trunk"),
        ({"objects": {"cube": {"geoms": {"0": flat}}}}, r"at least 4 vertices required"),
    ):
        with pytest.raises(ConfigError, match=rf"no scene can be made of it. .*{reason}.*Give a file that"):
            check_scenario_files(EnvSpec(scenario=changes), {})


def test_what_is_there_is_taken(tmp_path: Path, images: Path) -> None:
    file = str(resolve(PickCube().scenario.robots[0].mjcf))
    check_scenario_files(EnvSpec(scenario={"robots": {"franka": {"mjcf": file}}}), {})
    check_scenario_files(EnvSpec(scenario=TABLE), {"materials": f"+{images}"})
    wood = {"appearance": {"materials": {"table": {"texture": "wood-017"}}}}
    check_scenario_files(EnvSpec(scenario=wood), {"materials": ""})


def test_a_material_must_be_in_every_library(images: Path) -> None:
    both = {"materials": f"+{images}", "evaluate.materials": ""}
    with pytest.raises(
        ConfigError,
        match=rf"^{TEXTURE}=table\.png: .* evaluate\.materials=\+<folder> adds\. Unknown material",
    ):
        check_scenario_files(EnvSpec(scenario=TABLE), both)
    (images / "table.png").rename(images / "tables.png")
    with pytest.raises(ConfigError, match=r"Unknown material 'table\.png'\. Did you mean 'tables\.png'\?"):
        check_scenario_files(EnvSpec(scenario=TABLE), {"materials": f"+{images}"})


def test_a_folder_of_other_files_is_not_collected_into(tmp_path):
    (tmp_path / "thesis.tex").write_text("x")
    for name in ("thesis.tex", "data/frames.csv"):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text("x")
        for collecting in (
            lambda: check_folders(compose("collect", [f"dataset={tmp_path}"])),
            lambda: DatasetWriter(tmp_path, fps=20, features={}),
        ):
            with pytest.raises(DatasetError, match=rf"no dataset and holds other files, such as '{name}'"):
                collecting()
        assert [path for path in tmp_path.rglob("*") if path.is_file()] == [file]
        file.unlink()


def test_missing_dataset_suggests_nearest(tmp_path):
    there = tmp_path / "datasets" / "PickCube" / "level0"
    (there / "meta").mkdir(parents=True)
    (there / "meta/info.json").touch()
    where = f"datasets_dir={tmp_path / 'datasets'}"
    for typo in (there.with_name("level"), tmp_path / "dataset" / "PickCube" / "level0", there.parent):
        with pytest.raises(ConfigError, match=r"info.json is missing\)\. Did you mean '") as caught:
            check_folders(compose("train", [f"dataset={typo}", where]))
        assert f"'{there}'? Check the path" in str(caught.value)
    with pytest.raises(ConfigError, match=r"there is no dataset \(meta/info.json is missing\)\. Check the"):
        check_folders(compose("train", [f"dataset={tmp_path / 'typo'}", f"datasets_dir={tmp_path}"]))


@pytest.mark.parametrize("command", ["collect", "train"])
def test_datasets_that_cannot_be_written_are_reported_before_anything_starts(command):
    for folder in ("/proc/here", "x" * 300):
        with pytest.raises(ConfigError, match=rf"^datasets_dir={folder[:90]}.*Choose another folder"):
            check_folders(compose(command, [f"datasets_dir={folder}"]))


@pytest.mark.parametrize(
    ("command", "words"), [("train", []), ("evaluate", ["policy=expert", "task=PickCube"])]
)
def test_a_folder_of_datasets_is_no_place_for_results(command, words, tmp_path):
    (tmp_path / "PickCube" / "meta").mkdir(parents=True)
    (tmp_path / "PickCube" / "meta" / "info.json").write_text("{}")
    with pytest.raises(ResultError, match=r"is not a folder of results: it holds the dataset '.*PickCube'"):
        check_folders(compose(command, [*words, f"results_dir={tmp_path}"]))


def test_training_without_collecting_needs_no_folder_of_datasets(tmp_path):
    words = [f"{key}={tmp_path / key}" for key in ("runs_dir", "results_dir")]
    check_folders(compose("train", ["policy=ppo", "datasets_dir=/proc/here", *words]))
