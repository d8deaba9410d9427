"""The container file installs what the README installs, and its image runs the README's first command."""

import json
import re
import shlex
import shutil
import subprocess
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
    copied = [word for rest in arguments("COPY") for word in rest.split()[:-1] if not word.startswith("--")]
    for source in copied:
        assert (ROOT / source).exists() and f"!{source}" in allowed, source
    assert {f"!{source}" for source in copied} == {line for line in allowed if line.startswith("!")}


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
