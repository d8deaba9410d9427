"""Writes one episode to a Rerun recording: a scene, its cameras, and a text of the draws."""

import importlib
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import mujoco
import numpy as np

from envs.core.atomic import atomic_path
from envs.core.errors import MissingExtraError
from envs.core.extras import install_command
from envs.simulators.hybrid import make_handler
from envs.simulators.mujoco.render import Stage
from envs.state import State
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.viewer.geometry import visible_meshes

TIMELINE = "time"
_JPEG_QUALITY = 90
_GRPC_PORT, _WEB_PORT = 9876, 9090  # those of Rerun


def load_rerun() -> Any:
    """Imports the viewer's library.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        return importlib.import_module("rerun")
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"roboverse view needs the package '{error.name}', which is not installed. "
            f"Install it with: {install_command('viewer')}"
        ) from error


class EpisodeRecording:
    """A Rerun recording of one episode of an environment.

    Entities: ``scene/<body>/<geom>`` and ``scene/cameras/<camera>`` in the world frame, m;
    ``draws``, a text.

    Args:
        env: The environment; its first environment is in the episode.
        title: What is recorded, in words.
    """

    def __init__(self, env: RoboVerseVectorEnv, title: str) -> None:
        self._rr = load_rerun()
        self._env, self._cameras = env, env.camera_names
        self._stream = self._rr.RecordingStream(f"roboverse {title}")
        # Any simulator's states are posed on MuJoCo's model of the scene.
        self._posing: Any = make_handler(
            "mujoco", env.scenario, 1, renderer="warp", textures=env.handler.textures
        )
        self._posing.launch()
        self._stage = Stage(self._posing.model, env.scenario)
        self._poses: dict[str, np.ndarray] = {}
        # Kept until it is known where they go: Rerun's server hangs if it starts after much was logged.
        self._calls: list[Callable[[], None]] = []

    def start(self, text: str) -> None:
        """Logs what does not change in the episode: meshes, cameras' sizes and the text."""
        episode = int(self._env.episodes[0])
        self._appearance = self._env.randomizer.appearance(episode)
        self._posing.set_appearance(self._appearance, 0)
        rr = self._rr
        self._log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log("draws", rr.TextDocument(text, media_type="text/markdown"), static=True)
        self._stage.pose(self._posing.snapshot()[0])
        model = self._stage.model
        for mesh in visible_meshes(
            self._stage, self._env.scenario, self._appearance, self._env.handler.textures
        ):
            body = int(model.geom_bodyid[mesh.geom])
            self._log(
                f"{self._path(body)}/{_entity(model.geom(mesh.geom).name or f'geom{mesh.geom}')}",
                rr.Mesh3D(
                    vertex_positions=mesh.vertices,
                    triangle_indices=mesh.triangles,
                    vertex_normals=mesh.normals,
                    vertex_texcoords=None if mesh.texture is None else mesh.uvs,
                    albedo_texture=mesh.texture,
                    albedo_factor=mesh.rgba,
                    face_rendering="Front",
                ),
                static=True,
            )
        for camera in self._env.scenario.cameras:
            half = np.deg2rad(model.cam_fovy[model.camera(camera.name).id]) / 2
            self._log(
                f"scene/cameras/{camera.name}",
                rr.Pinhole(
                    focal_length=float(camera.height / 2 / np.tan(half)),
                    width=camera.width,
                    height=camera.height,
                    camera_xyz=rr.ViewCoordinates.RUB,
                    image_plane_distance=0.15,
                ),
                static=True,
            )

    def add(self, time_s: float, state: State | None, images: Mapping[str, np.ndarray]) -> None:
        """Logs one moment.

        Args:
            time_s: Since the episode's start.
            state: One row; None leaves everything where it is.
            images: Camera to its image, (H, W, 3) uint8.
        """
        self._calls.append(partial(self._stream.set_time, TIMELINE, duration=time_s))
        if state is not None:
            self._posing.set_states(State.unflatten({k: v.cpu() for k, v in state.flatten().items()}), [0])
            self._stage.pose(self._posing.snapshot()[0])
            self._log_poses()
        for camera, image in images.items():
            compressed = self._rr.Image(image).compress(jpeg_quality=_JPEG_QUALITY)
            self._log(f"scene/cameras/{camera}", compressed)

    def _log_poses(self) -> None:
        model, data = self._stage.model, self._stage.data
        for body in range(1, model.nbody):
            self._log_pose(self._path(body), data.xpos[body], data.xquat[body])
        for name in self._cameras:
            camera, quat = model.camera(name).id, np.empty(4)
            mujoco.mju_mat2Quat(quat, data.cam_xmat[camera])
            self._log_pose(f"scene/cameras/{name}", data.cam_xpos[camera], quat)

    def _log_pose(self, path: str, pos: np.ndarray, quat: np.ndarray) -> None:
        """Logs a pose (position in m, quaternion w x y z) unless it is the last one of that entity."""
        pose = np.concatenate([pos, quat])
        if path in self._poses and np.array_equal(self._poses[path], pose):
            return
        self._poses[path] = pose
        turned = self._rr.Quaternion(xyzw=quat[[1, 2, 3, 0]])
        self._log(path, self._rr.Transform3D(translation=pos, quaternion=turned))

    def _path(self, body: int) -> str:
        return f"scene/{_entity(self._stage.model.body(body).name or f'body{body}')}"

    def _send(self) -> None:
        for call in self._calls:
            call()

    def _log(self, path: str, what: Any, *, static: bool = False) -> None:
        self._calls.append(partial(self._stream.log, path, what, static=static))

    def _views(self) -> Any:
        views = importlib.import_module("rerun.blueprint")
        images = [views.Spatial2DView(origin=f"scene/cameras/{name}", name=name) for name in self._cameras]
        right = views.Vertical(*images, views.TextDocumentView(origin="draws", name="episode"))
        scene = views.Spatial3DView(origin="scene", name="scene")
        return views.Blueprint(views.Horizontal(scene, right, column_shares=[2, 1]), collapse_panels=True)

    def write(self, path: Path) -> None:
        """Writes the recording to a file, atomically.

        Raises:
            WriteError: It cannot be written.
        """
        with atomic_path(path, keep_suffix=True) as temporary:
            self._stream.save(str(temporary), default_blueprint=self._views())
            self._send()
            self._stream.flush()
            self._stream.disconnect()

    def serve(self) -> str:
        """Opens the recording in the browser until this process ends; returns the page's address."""
        # With a blueprint as an argument, or anything logged before, Rerun 0.33 may never start it.
        address = self._stream.serve_grpc(grpc_port=_free_port(_GRPC_PORT))
        self._stream.send_blueprint(self._views())
        self._send()
        port = _free_port(_WEB_PORT)
        self._rr.serve_web_viewer(web_port=port, connect_to=address)
        return f"http://127.0.0.1:{port}/?url={quote(address, safe='')}"

    def close(self) -> None:
        """Frees the model."""
        self._posing.close()


def _free_port(usual: int) -> int:
    """Returns a usual port, or any free one where another program has it: a second viewer, for example."""
    for port in (usual, 0):
        with socket.socket() as listening, suppress(OSError):
            # As the viewer binds it: a connection that was closed a moment ago does not hold the port.
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(("0.0.0.0", port))
            return listening.getsockname()[1]
    return usual


def _entity(name: str) -> str:
    """Returns a name as one part of an entity's path: a slash would make a child of another entity."""
    return "".join(letter if letter.isalnum() or letter in "_-." else "." for letter in name)
