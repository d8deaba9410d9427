"""The command line: what it says, where it says it, and with which exit code."""

import logging
import re
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import policies
from benchmark.protocol import LEVELS
from envs.core.errors import DatasetError, PolicyError
from roboverse_learn import cli
from roboverse_learn.config.compose import compose, preset_names
from roboverse_learn.config.help import SUMMARIES
from roboverse_learn.training.interruption import Interrupted

HEAVY = (
    "torch",
    "mujoco",
    "warp",
    "lerobot",
    "hydra",
    "pydantic",
    "matplotlib",
    "rich",
    "scipy",
)


@pytest.fixture
def configurations(monkeypatch: pytest.MonkeyPatch) -> list:
    """Collects what the commands would have been called with."""
    seen: list = []
    monkeypatch.setattr(cli, "_run", lambda command, config: seen.append((command, config)))
    return seen


def failure(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Runs a command that must fail as a user's mistake; returns its one line."""
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1, captured.err
    assert "Traceback" not in captured.err
    return captured.err


@pytest.mark.slow
def test_of_many_names_the_five_nearest_are_listed_and_where_all_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    said = failure(["train", "task=PickCub"], capsys)
    found = re.search(r"Nearest of \d+: ([^.]*)\. roboverse list tasks shows all\.", said)
    assert found, said
    assert len(set(found[1].split(", "))) == 5 and found[1].startswith("PickCube, ")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["train", "task=PickCub"], "Unknown task 'PickCub'. Did you mean 'PickCube'? Nearest of "),
        (["train", "policy=atc"], "Unknown policy 'atc'. Did you mean 'act'? Valid: act, diffusion, "),
        (["train", "preset=qick"], "Unknown preset 'qick'. Did you mean 'quick'? Valid: full, "),
        (["train", "simulator=mujco"], "Unknown simulator 'mujco'. Did you mean 'mujoco'?"),
        (
            ["train", "renderer=wrap"],
            "Unknown renderer 'wrap'. Did you mean 'warp'? Valid: filament, genesis, gl, mujoco, "
            "mujoco_warp, newton, pybullet, sapien, warp.",
        ),
        (["train", "train.stpes=10"], "Unknown key 'train.stpes' of train. Did you mean 'train.steps'?"),
        (["train", "polcy=act"], "Unknown key 'polcy' of train. Did you mean 'policy'?"),
        (["train", "stpes=3"], "Unknown key 'stpes' of train. Did you mean 'train.steps'?"),
        (["train", "level=4"], "Unknown level '4'. Valid levels: 0: task; 1: "),
        (["train", "levels=[0,9]"], "Unknown level 9. Valid: 0, 1, 2, 3."),
        (["train", "splits=[val]"], "evaluate.splits.0: input should be 'train', 'validation' or 'test'"),
        (["train", "only=colour"], "Unknown channel 'colour'."),
        (["train", "num_envs=3"], "'num_envs' could be collect.num_envs or evaluate.num_envs"),
        (["train", "train.lr=fast"], "train.lr: input should be a valid number"),
        (["train", "train.lr=-1"], "train.lr must be above 0, given -1.0."),
        (["train", "train.lr=nan"], "train.lr must be a finite number, given nan."),
        (["train", "train.lr=inf"], "train.lr must be a finite number, given inf."),
        (["train", "cameras=[front,front]"], "names a camera twice. Name each once."),
        (["collect", "dataset=" + 300 * "x"], "…: File name too long. Choose another folder."),
        (["collect", "datasets_dir=" + 300 * "x"], "…: File name too long. Choose another folder."),
        (["train", "results_dir=/proc/results"], "results_dir=/proc/results: No such file or directory."),
        (
            ["evaluate", "checkpoint=x", "results_dir=/proc/x"],
            "results_dir=/proc/x: No such file or directory.",
        ),
        (
            ["train", "policy.dim_model=63"],
            "policy.dim_model=63 must be a multiple of 4 and of policy.n_heads=8",
        ),
        (["train", "policy.down_dims=[64]"], "Unknown key 'policy.down_dims' of train."),
        (
            ["train", "policy=ppo", "policy.model_size=5"],
            "Unknown key 'policy.model_size' of train. It is a key of policy=tdmpc2. Valid: ",
        ),
        (["train", "policy=fasttd3", "observation=pixels"], "It is a key of policy=ppo and policy=tdmpc2."),
        (["train", "policy=tdmpc2", "policy.observation=pixel"], "input should be 'state' or 'pixels'"),
        (["train", "policy_name=act"], "Unknown key 'policy_name' of train. Did you mean 'policy'?"),
        (["train", "steps"], "'steps' is not key=value."),
        (["train", "--steps=3"], "'--steps=3' is not key=value."),
        (["train", "train.steps=[1"], "train.steps=[1' cannot be read: check its brackets and quotes."),
        (["train", "seed=1,2"], "For a run with each of them: roboverse sweep seed=1,2"),
        (["train", "image_size=4"], "image_size must be 16 to 2048 pixels, given 4."),
        (["collect", "num_demos=0"], "num_demos must be above 0, given 0."),
        (
            ["collect", "num_demos=20000"],
            "num_demos must be at most 9,000, the train split's episodes, given 20,000.",
        ),
        (["collect", "train.steps=5"], "Unknown key 'train.steps' of collect."),
        (["evaluate"], "evaluate needs checkpoint=<folder>"),
        (["evaluate", "checkpoint=x", "levels=[]"], "evaluate needs a split and a level"),
        (
            ["evaluate", "checkpoint=x", "episodes=5000"],
            "episodes must be at most 1,000, the test split's episodes, given 5,000. "
            "Give episodes=1000 or splits=[train].",
        ),
        (
            ["evaluate", "checkpoint=x", "episodes=100000"],  # of two splits, the one that allows fewer
            "must be at most 1,000, the test split's episodes, given 100,000. Give episodes=1000.",
        ),
        (["train", "splits=[train]", "episodes=9001"], "episodes must be at most 9,000, the train split's"),
        (["leaderboard", "task=PickCube"], "Unknown key 'task' of leaderboard. Valid: prune_videos, results"),
        (["trian"], "Unknown command 'trian'. Did you mean 'train'? Valid: assets, check, collect"),
        (["speed", "stpe"], "Unknown speed program 'stpe'"),
        (["speed", "turns=2"], "'turns=2' is a setting of one program, given 0 names. Valid: agents, "),
        (
            ["train", "task_kwargs.varient=lift"],
            "Unknown option of PickCube 'varient'. Did you mean 'variant'?",
        ),
        (["train", "task_kwargs.variant=drop"], "Unknown variant of PickCube 'drop'. Valid: goal, lift."),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_mistake_is_one_line_and_exit_code_2(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str], configurations: list
) -> None:
    assert said in failure(words, capsys)
    assert not configurations


@pytest.mark.parametrize("below", ["", "/new/folder"], ids=["itself", "above"])
@pytest.mark.parametrize(
    ("command", "key"),
    [
        *(("train", key) for key in ("dataset", "datasets_dir", "run", "runs_dir", "results_dir")),
        *(("collect", "dataset"), ("collect", "datasets_dir"), ("leaderboard", "results_dir")),
        *(("sweep", "runs_dir"), ("replay", "dataset"), ("conservation", "out"), ("convert", "out")),
        *(("export", "out"), ("teleoperate", "recordings")),
    ],
)
def test_folder_that_is_a_file_is_refused_before_the_run(
    command: str,
    key: str,
    below: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    configurations: list,
) -> None:
    file = tmp_path / "file"
    file.write_text("not a folder")
    said = failure([command, f"{key}={file}{below}"], capsys)
    assert f"{key}={file}{below}: '{file}' is a file, not a folder. Name another folder" in said
    assert not configurations
    assert [path.name for path in tmp_path.iterdir()] == ["file"] and file.read_text() == "not a folder"


def test_a_folder_below_the_given_one_that_is_a_file_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "PickCube"
    file.write_text("not a folder")
    for path in (file, file / "act"):
        monkeypatch.setattr(cli, "_run", lambda *_, path=path: path.mkdir(parents=True))
        assert f"'{file}' is a file, not a folder." in failure(["leaderboard"], capsys)


def test_a_file_that_exists_and_should_not_is_a_bug(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "_run", lambda *_: tmp_path.mkdir())
    with pytest.raises(FileExistsError):
        cli.main(["leaderboard"])


def test_file_source_may_exceed_the_split_size() -> None:
    config = compose("collect", ["source=maniskill", "path=recorded.h5", "num_demos=20000"])
    assert config.collect.num_demos == 20_000


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["collect", "materials=nowhere"],
        ["train", "materials=nowhere", "slow_ok=true"],
        ["train", "evaluate.materials=+nowhere", "slow_ok=true"],
        ["evaluate", "checkpoint=runs/x", "materials=nowhere"],
    ],
)
def test_wrong_materials_folder_is_refused_before_the_run(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    said = failure([*words, "preset=quick"], capsys)
    assert said.startswith("error: No folder of materials at 'nowhere'. Give a folder")
    assert "worker" not in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [DatasetError("no such dataset"), PolicyError("broken checkpoint")])
def test_errors_of_every_package_are_printed_alike(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(cli, "_run", fail)
    assert failure(["leaderboard"], capsys) == f"error: {error}\n"


@pytest.mark.slow
def test_a_speed_program_gets_its_settings(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["speed", "startup", "turns=2"]) == 2
    assert "Unknown key of roboverse speed startup 'turns'" in capfd.readouterr().err
    assert cli.main(["speed", "dataset", "--help"]) == 0
    assert "roboverse speed dataset key=value" in capfd.readouterr().out


def test_full_disk_is_reported_and_the_same_command_resumes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device", "runs/x/metrics.jsonl")

    monkeypatch.setattr(cli, "_run", fail)
    said = failure(["leaderboard"], capsys)
    assert "No space left on device: runs/x/metrics.jsonl. Free some space" in said


@pytest.mark.parametrize("name", ["manifest.json", "collection.json", "run.log", "file-000.mp4"])
def test_a_folder_in_place_of_a_file_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).mkdir()
    said = f"error: '{tmp_path / name}' is a folder, where a file belongs. If you named it, name a file; "
    for use in (Path.read_bytes, logging.FileHandler):
        monkeypatch.setattr(cli, "_run", lambda *_, use=use: use(tmp_path / name))
        assert failure(["leaderboard"], capsys).startswith(said)


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(cli, "_run", fail)
    with pytest.raises(ZeroDivisionError):
        cli.main(["leaderboard"])


@pytest.mark.parametrize(
    ("interrupt", "code"),
    [(KeyboardInterrupt(), 130), (Interrupted(signal.SIGINT), 130), (Interrupted(signal.SIGTERM), 143)],
)
def test_an_interrupt_says_how_to_go_on(
    interrupt: KeyboardInterrupt,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def run(*_: object) -> None:
        raise interrupt

    monkeypatch.setattr(cli, "_run", run)
    assert cli.main(["leaderboard"]) == code
    assert "the same command continues" in capsys.readouterr().err


@pytest.mark.parametrize("words", [[], ["-h"], ["--help"], ["help"]])
def test_help_lists_what_there_is_with_defaults(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    for heading in ("Usage", "Commands", "Tasks", "Policies", "Simulators", "Renderers", "Robots", "Presets"):
        assert f"{heading}:" in said
    for name in (
        *policies.names(),
        *preset_names(),
        "mujoco",
        "warp",
        "gl",
        "filament",
        "franka",
        "h1",
        "sawyer",
        "ant",
        "cartpole",
    ):
        assert f"  {name} " in said
    for line in ("seed=0", "level=0", "evaluate.levels=[0,1,2,3]", "collect.num_demos=1000", "resume=true"):
        assert f"  {line} " in said
    assert max(map(len, said.splitlines())) < 200


@pytest.mark.parametrize("command", ["train", "collect", "evaluate", "leaderboard"])
def test_the_help_of_a_command_explains_every_key(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([command, "--help"]) == 0
    _, _, keys = capsys.readouterr().out.partition("Keys, with their defaults:\n")
    for line in keys.splitlines():
        key, _, about = line.strip().partition("  ")
        assert "=" in key and about.strip(), f"{command} does not explain '{line.strip()}'"


@pytest.mark.parametrize("command", ["", *SUMMARIES])
def test_help_has_no_marks_of_docstrings(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    chosen = [f"policy={name}" for name in policies.names()] if command == "train" else [""]
    for words in ([command, policy, "--help"] for policy in chosen):
        assert cli.main([*filter(None, words)]) == 0
    assert re.findall(r".*(?::\w+:`|``).*", capsys.readouterr().out) == []


@pytest.mark.parametrize(
    "words",
    [["dataset"], ["dataset", "--help"], ["list", "--help"], ["list", "tasks", "-h"], ["assets", "help"]],
)
def test_the_help_of_a_command_that_takes_words_shows_them(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    assert f"Usage:\n  roboverse {words[0]} " in said and len(said.splitlines()) < 9


def test_the_help_of_train_shows_the_keys_of_the_policy_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["train", "policy=diffusion", "--help"]) == 0
    said = capsys.readouterr().out
    assert "policy.down_dims=[256,512,1024]" in said and "policy.chunk_size" not in said


@pytest.mark.slow
@pytest.mark.parametrize("words", [["list"], ["--help"], ["train", "--help"], ["evaluate", "polcy=act"]])
def test_listing_and_help_import_nothing_heavy(words: list[str]) -> None:
    code = (
        f"import sys; from roboverse_learn.cli import main; main({words!r})\n"
        f"print('heavy:', sorted(set({HEAVY!r}) & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        cwd=Path(__file__).resolve().parents[3],
    )
    assert done.stdout.splitlines()[-1] == "heavy: []"


@pytest.mark.slow
def test_list_into_a_closed_pipe_is_no_error() -> None:
    command = f"'{sys.executable}' -m roboverse_learn list | true; exit ${{PIPESTATUS[0]}}"
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, check=False, timeout=60, cwd=root
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"roboverse {version('roboverse-learn')}\n"


@pytest.mark.slow
def test_the_package_runs_as_a_module_and_says_nothing_else() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "roboverse_learn", "--version"], capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == (f"roboverse {version('roboverse-learn')}\n", "")


def test_bare_sweep_prints_its_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["sweep"]) == 0
    assert "Usage: roboverse sweep" in capsys.readouterr().out


def test_every_level_is_accepted(configurations: list) -> None:
    for level in LEVELS:
        assert cli.main(["train", f"level={level}"]) == 0
    assert [config.env.level for _, config in configurations] == list(LEVELS)
