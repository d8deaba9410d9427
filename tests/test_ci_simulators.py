"""``.ci/simulators``: what cannot be had is named with the reason, and fails no run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PYTHON = f"""#!/bin/sh
case "$*" in
    *sapien.Scene*) exit 1 ;;
    *"import sapien"*) exit "$SAPIEN" ;;
    *mujoco.egl*) exit "$EGL" ;;
    *mujoco.osmesa*) case "$LD_LIBRARY_PATH" in *osmesa*) exit 0 ;; *) exit 1 ;; esac ;;
    *) exec {sys.executable} "$@" ;;
esac
"""


def program(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture
def install(tmp_path):
    """Runs it as ``.ci/run`` does, with programs that we give."""

    def run(uv, *, sapien=1, egl=0, apt="exit 0", show="VK_DRIVER_FILES"):
        program(tmp_path / "venv/bin/python", PYTHON)
        program(tmp_path / "venv/bin/uv", f"#!/bin/sh\n{uv}\n")
        program(tmp_path / "bin/apt-get", f"#!/bin/sh\n{apt}\n")
        script = f'source .ci/simulators; install_simulators {tmp_path}/venv; echo "${{{show}:-none}}"'
        kept = {key: value for key, value in os.environ.items() if not key.startswith("VK_")}
        env = {key: kept[key] for key in kept if key not in ("MUJOCO_GL", "LD_LIBRARY_PATH")}
        env |= {
            "SAPIEN": str(sapien),
            "EGL": str(egl),
            "ROBOVERSE_CI_CACHE": str(tmp_path / "cache"),
            "PATH": f"{tmp_path}/bin:{os.environ['PATH']}",
        }
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", script], cwd=ROOT, env=env, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_without_a_network_everything_is_named_and_nothing_fails(install):
    said = install("echo no route to host >&2; exit 1")
    for name in ("sapien", "usd", "viewer", "pybullet"):
        assert f"{name:10} not installed: no route to host" in said
    assert "Vulkan     not looked for: SAPIEN is not installed" in said
    assert said.endswith("none\n")


def test_a_wheel_that_was_built_is_not_built_again(install, tmp_path):
    tag = "cp{}{}".format(*sys.version_info)
    program(tmp_path / f"cache/wheels/pybullet-3.2.7-{tag}-{tag}-linux_x86_64.whl", "")
    said = install("exit 0")
    assert f"pybullet   installed, from {tmp_path}/cache/wheels" in said
    assert "building" not in said


@pytest.mark.slow
@pytest.mark.parametrize("apt", ["exit 0", "echo E: no mirror answers; exit 100"])
def test_without_a_driver_the_reason_is_given(install, apt):
    said = install("exit 0", sapien=0, apt=apt)
    assert "Vulkan     no driver that SAPIEN can draw with: " in said
    assert any(
        reason in said for reason in ("No mirror of", "No backports are known", "E: no mirror answers")
    )
    assert said.endswith("none\n")


@pytest.mark.parametrize("show", ["MUJOCO_GL", "LD_LIBRARY_PATH"])
def test_where_egl_draws_nothing_is_fetched_for_gl(install, show):
    said = install("exit 0", show=show)
    assert "GL         the system's own EGL" in said
    assert said.endswith("none\n")


@pytest.mark.parametrize("show", ["MUJOCO_GL", "LD_LIBRARY_PATH"])
def test_without_egl_osmesa_that_was_unpacked_is_taken_and_named(install, tmp_path, show):
    folder = tmp_path / "cache/osmesa/usr/lib"
    program(folder / "libOSMesa.so.8", "")
    said = install("exit 0", egl=1, show=show)
    assert f"GL         OSMesa, unpacked in {tmp_path}/cache/osmesa" in said
    assert said.endswith({"MUJOCO_GL": "osmesa\n", "LD_LIBRARY_PATH": f"{folder}\n"}[show])


@pytest.mark.parametrize("show", ["MUJOCO_GL", "LD_LIBRARY_PATH"])
@pytest.mark.parametrize("apt", ["exit 0", "echo E: no mirror answers; exit 100"])
def test_without_any_gl_the_reason_is_given(install, apt, show):
    said = install("exit 0", egl=1, apt=apt, show=show)
    assert "GL         none that MuJoCo can draw with: " in said
    assert any(
        reason in said for reason in ("No mirror of", "No backports are known", "E: no mirror answers")
    )
    assert said.endswith("none\n")


def test_only_what_the_project_offers_is_installed(install):
    assert "genesis-of-nothing" not in install("exit 0")
    script = (ROOT / ".ci/simulators").read_text()
    assert "sudo" not in script and "://" not in script
