"""Where a checkpoint of the hub comes from: the cache, or a download that the machine has room for."""

from types import SimpleNamespace

import psutil
import pytest

from envs.core.errors import PolicyError
from policies.zoo import source


@pytest.mark.parametrize("name", ["lerobot/smolvla_base", "openvla/openvla-7b@main"])
def test_hub_names(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert source.is_hub_name(name)
    (tmp_path / name.split("/")[0]).mkdir()
    assert not source.is_hub_name(name)  # a folder here that lacks the second


def test_a_path_is_none():
    assert not source.is_hub_name("runs/PickCube/act")
    assert not source.is_hub_name("/runs/PickCube")


def test_without_a_network_the_error_names_the_network(monkeypatch, tmp_path):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(PolicyError, match=r"'nobody/nothing' is no folder here, and the Hugging"):
        source.local_folder("nobody/nothing")


def test_a_host_that_is_not_found_is_one_sentence_too(monkeypatch):
    import httpx

    def no_host(*_):
        raise httpx.ConnectError("[Errno -2] Name or service not known")

    monkeypatch.setattr(source, "_hub_bytes", no_host)
    with pytest.raises(
        PolicyError, match=r"hub did not give it: \[Errno -2\] Name or service not known. Name"
    ):
        source.local_folder("nobody/nothing")


def test_room_is_checked_before_a_download(monkeypatch, tmp_path):
    free = {"disk": 17e9, "memory": 32e9}
    monkeypatch.setattr(source.shutil, "disk_usage", lambda _: SimpleNamespace(free=free["disk"]))
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=free["memory"]))
    source.check_room(int(15e9), tmp_path / "cache", "a/b")
    free["memory"] = 31e9  # what is read and the network are there at once
    with pytest.raises(PolicyError, match=r"has 15.0 GB, which needs 31.5 GB of free memory.* 31.0 GB"):
        source.check_room(int(15e9), tmp_path, "a/b")
    free["disk"] = 16e9
    with pytest.raises(PolicyError, match=r"which needs 16.5 GB of free disk.* Nothing was down.*HF_HOME"):
        source.check_room(int(15e9), tmp_path, "a/b")


def test_a_cache_that_lacks_the_weights_is_completed(monkeypatch, tmp_path):
    """LeRobot and transformers fetch a configuration alone, which leaves a snapshot without weights."""
    asked = []

    def download(name, *, local_files_only=False, **_):
        asked.append(local_files_only)
        (tmp_path / "config.json").write_text("{}")
        if not local_files_only:
            (tmp_path / "model.safetensors.index.json").write_text("{}")
        return str(tmp_path)

    monkeypatch.setattr("huggingface_hub.snapshot_download", download)
    monkeypatch.setattr(source, "_hub_bytes", lambda *_: 1)
    for expected in ([True, False], [True]):
        asked.clear()
        assert source.local_folder("somebody/something") == tmp_path
        assert asked == expected
