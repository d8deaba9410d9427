"""The ray tracer comes without the physics of its package, and both are one package afterwards."""

import subprocess
import sys

import pytest

_IMAGE_WITHOUT_PHYSICS = """
import sys
import envs
env = envs.make_vec("PickCube", num_envs=1, image_size=16)
observation, _ = env.reset(seed=0)
assert observation["pixels"]["front"].any()
assert "mujoco_warp._src.render" in sys.modules
print([name for name in sys.modules if name in ("mujoco_warp", "mujoco_warp._src.solver")])
"""

_PACKAGE_AFTERWARDS = """
from envs.simulators.mujoco.tracer_parts import tracer_parts
parts = tracer_parts()
import mujoco_warp
print([name for name in parts._fields if getattr(mujoco_warp, name) is not getattr(parts, name)])
print(callable(mujoco_warp.step))
"""

_OTHER_LAYOUT = """
import sys
from envs.simulators.mujoco import tracer_parts
class Hidden:
    def find_spec(self, name, path, target=None):
        if name == "mujoco_warp._src.render_util" and not hidden:
            hidden.append(name)
            raise ImportError(name)
hidden = []
sys.meta_path.insert(0, Hidden())
parts = tracer_parts.tracer_parts()
import mujoco_warp
print(hidden, parts.render is mujoco_warp.render)
"""


def run(program: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_an_image_imports_no_physics_of_the_tracers_package():
    assert run(_IMAGE_WITHOUT_PHYSICS) == ["[]"]


@pytest.mark.slow
def test_the_whole_package_has_the_same_functions_afterwards():
    assert run(_PACKAGE_AFTERWARDS) == ["[]", "True"]


@pytest.mark.slow
def test_a_version_with_other_modules_is_imported_whole():
    assert run(_OTHER_LAYOUT) == ["['mujoco_warp._src.render_util'] True"]
