"""The commit of a checkout."""

import subprocess

from envs.core.git import git, git_sha, is_tracked


def commit_files(root):
    """Makes a checkout with one commit of a file, and of one in ``results/``."""

    def run(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
        subprocess.run(["git", "-C", root, *who, *words], check=True, capture_output=True)

    run("init")
    (root / "results").mkdir()
    for name in ("a", "results/tasks.json"):
        (root / name).write_text("1")
    run("add", "a", "results")
    run("commit", "-m", "one")


def test_git_sha_is_marked_when_files_differ(tmp_path):
    assert git_sha(tmp_path) is None
    commit_files(tmp_path)
    clean = git_sha(tmp_path)
    assert len(clean) == 40
    (tmp_path / "results/tasks.json").write_text("2")
    assert git_sha(tmp_path) == git_sha(tmp_path / "results") == clean
    (tmp_path / "a").write_text("2")
    assert git_sha(tmp_path) == clean + "+"


def test_a_checkout_whose_state_is_unknown_counts_as_changed(tmp_path):
    commit_files(tmp_path)
    clean = git_sha(tmp_path)
    (tmp_path / ".git/index").write_text("damaged")
    assert git(tmp_path, "status") is None
    assert git_sha(tmp_path) == clean + "+"


def test_a_repository_without_files_is_no_checkout(tmp_path):
    commit_files(tmp_path)
    assert git_sha(tmp_path / ".git") is None


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
