"""``roboverse new``: what is written, and what is refused."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from envs.core.registry import PLUGINS_VARIABLE
from roboverse_learn import cli
from roboverse_learn.config.compose import compose
from roboverse_learn.config.other_commands import NEW_KINDS, NewConfig
from roboverse_learn.new import TEMPLATES, render

ROOT = Path(__file__).resolve().parents[3]
NAMES = {"task": "LiftBlock", "policy": "my_cnn", "robot": "my_arm"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(PLUGINS_VARIABLE, "")
    return tmp_path


def failure(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.main(["new", *words]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("error: ") and captured.err.count("\n") == 1
    return captured.err


@pytest.mark.parametrize("kind", NEW_KINDS)
def test_a_package_is_written_with_its_next_steps(
    kind: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["new", kind, f"name={NAMES[kind]}"]) == 0
    said = capsys.readouterr().out
    module = {"task": "lift_block"}.get(kind, NAMES[kind])
    project = tomllib.loads((folder / module / "pyproject.toml").read_text(encoding="utf-8"))
    assert f"roboverse check {kind}={NAMES[kind]} plugins=[{module}]" in said and "\n  cd" not in said
    assert project["project"]["name"] == module.replace("_", "-")
    for group, points in project["project"]["entry-points"].items():
        assert group in ("roboverse.tasks", "roboverse.policies", "roboverse.robots")
        for target in points.values():
            file, _, attribute = target.partition(":")
            text = (folder / module / f"{file.replace('.', '/')}.py").read_text(encoding="utf-8")
            assert f"class {attribute}(" in text or f"{attribute} = " in text
            assert f'"{target}"' in (folder / module / module / "__init__.py").read_text(encoding="utf-8")
    for path in (folder / module).rglob("*"):
        assert path.is_dir() or not {"{{", "{%"} & {*path.read_text(encoding="utf-8").split()}


@pytest.mark.parametrize("kind", NEW_KINDS)
def test_what_is_written_is_clean_under_its_own_settings(kind: str, folder: Path) -> None:
    assert cli.main(["new", kind, f"name={NAMES[kind]}", "out=made"]) == 0
    rules = [
        "--select=E,F,I,UP,B,SIM,N,D,RUF",
        "--config=lint.pydocstyle.convention='google'",
        "--ignore=D105,D107",
    ]
    for command in (["check", *rules], ["format", "--check"]):
        words = [sys.executable, "-m", "ruff", *command, "--no-cache", "made"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("name", "module", "class_name"),
    [
        ("LiftBlock", "lift_block", "LiftBlock"),
        ("lift_block", "lift_block", "LiftBlock"),
        ("UR5Arm", "ur5_arm", "UR5Arm"),
        ("myCNN", "my_cnn", "MyCNN"),
        ("Reach2", "reach2", "Reach2"),
        ("a__b_", "a_b", "AB"),
    ],
)
def test_package_and_class_are_named_after_the_name(name: str, module: str, class_name: str) -> None:
    config = NewConfig(name=name)
    assert (config.module, config.class_name) == (module, class_name)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["tsak", "name=A"],
            "Unknown kind of skeleton 'tsak'. Did you mean 'task'? Valid: policy, ",
        ),
        ([], "new task needs name=<name>, as in: roboverse new task name=LiftBlock"),
        (["policy"], "new policy needs name=<name>, as in: roboverse new policy name=my_cnn"),
        (["task", "name=1st"], "name=1st is no name of letters, digits and underscores"),
        (["task", "name=a-b"], "name=a-b is no name of letters"),
        (["task", "name=../up"], "name=../up is no name of letters"),
        (["task", "name=Würfel"], "name=Würfel is no name of letters"),
        (["task", "name=Class"], "name=Class is a word of Python"),
        (["task", "name=PickCube"], "'PickCube' is registered already, see roboverse list tasks"),
        (["policy", "name=act"], "'act' is registered already, see roboverse list policies"),
        (["robot", "name=franka"], "'franka' is registered already, see roboverse list robots"),
        (["task", "name=Json"], "its package would be called 'json', as one that is installed here"),
        (["task", "A", "B"], "'B' is not key=value."),
        (["task", "nam=A"], "Unknown key 'nam' of new. Did you mean 'name'?"),
        (["task", "name=A", "out=/proc/x"], "out=/proc/x: No such file or directory."),
        (
            ["task", "name=LiftBlock", "out=."],
            "out=. is the folder that you are in. Leave out= away, or name a new one.",
        ),
        (["task", "name=LiftBlock", "out=new/.."], "out=new/.. is the folder that you are in."),
    ],
)
def test_a_wrong_word_is_one_sentence(
    words: list[str], said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said in failure(words, capsys)
    assert list(folder.iterdir()) == []


def test_nothing_is_overwritten(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "lift_block").mkdir()
    (folder / "lift_block" / "mine.py").write_text("mine")
    (folder / "file").write_text("mine")
    said = failure(["task", "name=LiftBlock"], capsys)
    assert "'lift_block' exists, and nothing is overwritten. Choose another folder by out=" in said
    assert "'file' is a file, not a folder" in failure(["task", "name=LiftBlock", "out=file"], capsys)
    assert [path.name for path in (folder / "lift_block").iterdir()] == ["mine.py"]
    assert (folder / "file").read_text() == "mine"


def test_an_empty_folder_is_filled_and_named_in_the_next_steps(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "deep" / "empty").mkdir(parents=True)
    assert cli.main(["new", "task", "name=LiftBlock", "out=deep/empty"]) == 0
    assert (folder / "deep" / "empty" / "lift_block" / "task.py").is_file()
    said = capsys.readouterr().out
    assert "\n  cd deep/empty\n" in said
    assert "After 'pip install --no-deps -e .', in the same folder, " in said, "after the cd"


@pytest.mark.parametrize("kind", NEW_KINDS)
def test_the_next_steps_the_readme_and_the_page_install_by_one_command(
    kind: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["new", kind, f"name={NAMES[kind]}"]) == 0
    module = {"task": "lift_block"}.get(kind, NAMES[kind])
    installs = "pip install --no-deps -e"
    assert f"After '{installs} {module}', in the same folder, " in capsys.readouterr().out
    readme = (folder / module / "README.md").read_text(encoding="utf-8")
    assert f"`{installs} .`, run here too, registers" in readme
    assert "here, in the folder of this file:" in readme.replace("\n", " ")
    page = (ROOT / "docs/howto/start_your_own.md").read_text(encoding="utf-8")
    assert f"After `{installs} lift_block`, in the same folder, " in page


@pytest.mark.parametrize("kind", NEW_KINDS)
def test_every_template_is_used(kind: str) -> None:
    templates = [path for path in (TEMPLATES / kind).iterdir()] + list((TEMPLATES / "shared").iterdir())
    assert len(render(NewConfig(kind=kind, name="x"))) == len(templates)
    assert {path.suffix for path in templates} == {".jinja"}


def test_the_second_word_may_be_the_name(folder: Path) -> None:
    assert cli.main(["new", "policy", "small", "out=made"]) == 0
    assert (folder / "made" / "small" / "policy.py").is_file()


def test_a_task_is_the_default() -> None:
    assert compose("new", ["name=LiftBlock"]) == NewConfig(kind="task", name="LiftBlock")
