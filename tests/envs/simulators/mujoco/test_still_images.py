"""Images that are put together are those that are traced whole."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from envs.scenario import LightCfg
from envs.simulators.mujoco import still_images
from envs.simulators.mujoco.render_warp import WarpRenderer
from envs.simulators.mujoco.still_images import StillImages
from envs.spec import EnvSpec

KINDS = ("rgb", "depth", "segmentation")


class Scene:
    """An environment, a renderer that keeps still images, and one that traces each image whole."""

    def __init__(self, level, size=40):
        self.env = EnvSpec(task="PickCube", level=level, image_size=size, cameras=("front", "wrist")).make(
            2, num_threads=1
        )
        handler: Any = self.env.handler
        looks = self.env.randomizer.library.texture
        self.kept, self.whole = (
            WarpRenderer(handler.model, handler.scenario, textures=looks, num_threads=1) for _ in range(2)
        )
        self.rng = np.random.default_rng(0)

    def move(self):
        low, high = self.env.controller.low, self.env.controller.high
        self.env.step_envs(np.arange(2), self.rng.uniform(low, high, (2, len(low))))

    def draw(self, jobs, cameras=("front",), kinds=KINDS):
        """Draws jobs with both and asserts that they agree; returns how many still images were used."""
        used, of = [], StillImages.of

        def counted(self, *args):
            still = of(self, *args)
            used.append(still is not None)
            return still

        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(StillImages, "of", counted)
            ours = self.kept.render(jobs, cameras, kinds)
            patched.setattr(StillImages, "of", lambda *args: None)
            theirs = self.whole.render(jobs, cameras, kinds)
        for camera in cameras:
            for kind in kinds:
                np.testing.assert_array_equal(ours[camera][kind], theirs[camera][kind], f"{camera} {kind}")
        return sum(used)


@pytest.fixture(scope="module", params=[0, 3])
def scene(request):
    made = Scene(request.param)
    yield made
    made.kept.close()
    made.whole.close()
    made.env.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cameras", "kinds"),
    [(("front",), ("rgb",)), (("front", "wrist"), KINDS), (("front",), ("segmentation",))],
)
def test_episodes_look_the_same(scene, cameras, kinds):
    """Of two environments in turn, while the arm and the cube move, and in further episodes."""
    used = 0
    for first in (0, 2):
        scene.env.reset_envs(np.arange(2), np.asarray(scene.env.split_indices[first : first + 2]))
        for _ in range(6):
            used += scene.draw(scene.env.handler.snapshot(), cameras, kinds)
            scene.move()
    assert used >= 12  # of 24: a look that is new is traced whole, twice where something moves later


@pytest.mark.slow
def test_what_rests_at_first_moves_later_and_comes_back(scene):
    scene.env.reset_envs(np.arange(2), np.asarray(scene.env.split_indices[:2]))
    jobs = []
    for _ in range(2):
        jobs.append(scene.env.handler.snapshot([0])[0])
        scene.move()
    (cube,) = (item for item in scene.env.handler.layout.objects if item.name == "cube")
    lifted = [dataclasses.replace(job, qpos=job.qpos.copy()) for job in jobs]
    for job in lifted:
        job.qpos[np.asarray(cube.root_qpos) + 2] += 0.2
    order = [*jobs, *jobs, *lifted, *jobs, *lifted]
    assert [scene.draw([job]) for job in order][2:] == [1] * 8


@pytest.mark.slow
def test_a_look_with_lamps_that_cast_shadows_is_traced_whole(scene):
    scene.env.reset_envs(np.arange(2), np.asarray(scene.env.split_indices[:2]))
    lamp = LightCfg(kind="area", pos=(0.5, 0.3, 2.0), intensity=0.5, cast_shadow=True)
    jobs = []
    for _ in range(4):
        jobs.append(scene.env.handler.snapshot([0])[0])
        scene.move()
    looks = dataclasses.replace(jobs[0].appearance, lights=(lamp,))
    assert [scene.draw([dataclasses.replace(job, appearance=looks)]) for job in jobs] == [0] * 4


@pytest.mark.slow
def test_few_looks_are_kept(scene, monkeypatch):
    monkeypatch.setattr(still_images, "KEPT_PIXELS", 1)
    scene.env.reset_envs(np.arange(2), np.asarray(scene.env.split_indices[:2]))
    (job,) = scene.env.handler.snapshot([0])
    looks = [dataclasses.replace(job, appearance=dataclasses.replace(job.appearance)) for _ in range(3)]
    scene.move()
    kinds = ("depth",)  # of a tracer that nothing was drawn with before
    order = [looks[0], looks[0], looks[1], looks[1], looks[0], looks[2], looks[1], looks[0]]
    assert [scene.draw([one], kinds=kinds) for one in order] == [0, 1, 0, 1, 1, 0, 0, 0]


@pytest.mark.slow
def test_a_camera_on_the_arm_has_no_still_image(scene):
    scene.env.reset_envs(np.arange(2), np.asarray(scene.env.split_indices[:2]))
    for _ in range(3):
        assert scene.draw(scene.env.handler.snapshot(), ("wrist",), ("rgb",)) == 0
        scene.move()
