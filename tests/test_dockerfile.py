"""The container file installs what the README installs, and its image runs the README's first command."""

import itertools
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import uuid
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def instructions() -> list[tuple[str, str]]:
    """Returns (name, arguments) of every instruction, lines joined and comments left out."""
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("#")).replace("\\\n", " ")
    return [
        (name, rest) for name, _, rest in (line.partition(" ") for line in text.splitlines() if line.strip())
    ]


def arguments(name: str) -> list[str]:
    return [rest for each, rest in instructions() if each == name]


def first_command() -> tuple[str, list[str]]:
    """Returns the installation of the README's first command, and the words of ``roboverse`` after it."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^python3\.12 -m venv .*train\.py .*$", readme, re.MULTILINE)
    install, _, run = line.rpartition(" && ")
    return install, ["train", *shlex.split(run)[2:]]


def copies() -> list[tuple[list[str], str]]:
    """Returns (sources, destination) of every ``COPY``."""
    words = [[word for word in rest.split() if not word.startswith("--")] for rest in arguments("COPY")]
    return [(each[:-1], each[-1]) for each in words]


def installed_folders() -> list[str]:
    """Returns the folders of the packages that the image installs from what it copies."""
    words = shlex.split(first_command()[0])
    return [folder for flag, folder in itertools.pairwise(words) if flag == "-e"]


def built_from(folder: str) -> list[str]:
    """Returns the files and folders that the package's build reads, from the root of the checkout."""
    settings = tomllib.loads((ROOT / folder / "pyproject.toml").read_text(encoding="utf-8"))
    project, wheel = settings["project"], settings["tool"]["hatch"]["build"]["targets"]["wheel"]
    names = ["pyproject.toml", *project.get("license-files", []), *wheel.get("packages", [])]
    names += [*filter(None, [project.get("readme")]), *wheel.get("force-include", {})]
    return [os.path.normpath(Path(folder, name)) for name in names]


def test_instructions_are_known() -> None:
    assert {name for name, _ in instructions()} == {
        *("ARG", "FROM", "ENV", "RUN", "USER", "WORKDIR", "COPY", "ENTRYPOINT", "CMD")
    }


def test_base_image_has_a_version() -> None:
    (image,) = [rest.partition("=")[2] for rest in arguments("ARG") if rest.startswith("PYTHON_IMAGE=")]
    assert arguments("FROM") == ["${PYTHON_IMAGE}"]
    assert re.fullmatch(r"python:3\.12\.\d+-slim-\w+", image), image


def test_copied_files_exist_and_are_not_ignored() -> None:
    allowed = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    copied = [source for sources, _ in copies() for source in sources]
    for source in copied:
        assert (ROOT / source).exists() and f"!{source}" in allowed, source
    assert {f"!{source}" for source in copied} == {line for line in allowed if line.startswith("!")}


def test_everything_that_the_packages_are_built_from_is_copied() -> None:
    copied = [Path(source) for sources, _ in copies() for source in sources]
    assert installed_folders()[0] == "."
    for folder in installed_folders():
        for name in built_from(folder):
            assert any(Path(name).is_relative_to(source) for source in copied), f"{folder} needs {name}"


@pytest.mark.slow
def test_what_is_copied_can_be_installed(tmp_path: Path) -> None:
    """The image's installation, without a daemon and without the packages of others."""
    uv = shutil.which("uv", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if uv is None:
        pytest.skip("no uv; the test before this one reads the files")

    def install(*words: str) -> subprocess.CompletedProcess[str]:
        command = [
            uv,
            "pip",
            "install",
            "--python",
            sys.executable,
            "--target",
            str(tmp_path / "site"),
            *words,
        ]
        return subprocess.run(command, cwd=tmp_path / "learn", capture_output=True, text=True, check=False)

    for sources, destination in copies():
        _copy(sources, destination, tmp_path / "learn")
    backend = install("hatchling", "editables")
    if backend.returncode:
        pytest.skip(f"the packages that build a wheel cannot be had: {backend.stderr.strip()[-200:]}")
    done = install("--no-deps", *(word for folder in installed_folders() for word in ("-e", folder)))
    assert done.returncode == 0, done.stderr
    program = "from envs.experts.counts import counts_file; print(counts_file().read_text())"
    counts = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path / "learn", capture_output=True, text=True, check=True
    )
    assert json.loads(counts.stdout) == json.loads((ROOT / "results/tasks.json").read_text(encoding="utf-8"))


def _copy(sources: list[str], destination: str, root: Path) -> None:
    """Copies as the instruction does: a folder's contents, or files into a folder or to a name."""
    for source in sources:
        target = root / destination / ("" if not destination.endswith("/") else Path(source).name)
        if (ROOT / source).is_dir():
            left_out = shutil.ignore_patterns("__pycache__", "*.egg-info")
            shutil.copytree(ROOT / source, root / destination, dirs_exist_ok=True, ignore=left_out)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / source, target)


def test_installation_and_command_are_those_of_the_readme() -> None:
    install, words = first_command()
    assert install in arguments("RUN")
    assert [*json.loads(arguments("ENTRYPOINT")[0]), *json.loads(arguments("CMD")[0])] == [
        "roboverse",
        *words,
    ]


def test_user_is_not_root() -> None:
    names = [name for name, _ in instructions()]
    assert arguments("USER") == ["roboverse"] and names.index("USER") < names.index("COPY")
    assert any(f"useradd --create-home --uid 1000 {arguments('USER')[0]}" in run for run in arguments("RUN"))


def _docker(*words: str, timeout_s: float = 60) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["docker", *words], capture_output=True, text=True, timeout=timeout_s, check=False)


@pytest.mark.long
def test_image_is_built_and_runs() -> None:
    if shutil.which("docker") is None or _docker("info").returncode:
        pytest.skip("no docker daemon; the other tests check the file")
    tag = f"roboverse-test:{uuid.uuid4().hex[:8]}"
    try:
        built = _docker("build", "--quiet", "--tag", tag, str(ROOT), timeout_s=3600)
        assert built.returncode == 0, built.stderr
        small = ["train.steps=4", "num_demos=4", "image_size=32", "episodes=1", "levels=[0]", "slow_ok=true"]
        done = _docker("run", "--rm", tag, *first_command()[1], *small, timeout_s=1800)
        assert done.returncode == 0, done.stderr
    finally:
        _docker("rmi", "--force", tag)
