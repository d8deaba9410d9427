"""The commit of a checkout."""

import subprocess

from envs.core.git import git, git_sha, is_tracked


def test_git_sha_is_marked_when_files_differ(tmp_path):
    assert git_sha(tmp_path) is None

    def run(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
        subprocess.run(["git", "-C", tmp_path, *who, *words], check=True, capture_output=True)

    run("init")
    (tmp_path / "results").mkdir()
    for name in ("a", "results/tasks.json"):
        (tmp_path / name).write_text("1")
    run("add", "a", "results")
    run("commit", "-m", "one")
    clean = git_sha(tmp_path)
    assert len(clean) == 40
    (tmp_path / "results/tasks.json").write_text("2")
    assert git_sha(tmp_path) == git_sha(tmp_path / "results") == clean
    (tmp_path / "a").write_text("2")
    assert git_sha(tmp_path) == clean + "+"


def test_a_file_that_git_does_not_know_is_not_of_the_checkout(tmp_path):
    subprocess.run(["git", "init", tmp_path], check=True, capture_output=True)
    for name in ("known", "new"):
        (tmp_path / name).write_text("1")
    assert git(tmp_path, "add", "known") == ""
    assert is_tracked(tmp_path / "known")
    assert not is_tracked(tmp_path / "new")


def test_an_error_of_git_gives_nothing(tmp_path):
    assert git(tmp_path, "no-such-command") is None
    assert git(tmp_path / "absent", "status") is None
