"""Shapes and motions on a page of viser, which includes the page's files. Tested in ``tests/test_view.py``."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .._tools.arrays import Array
from .._tools.plugins import optional
from ..errors import PlotError
from ..model.kinematics import frames
from ..robot.robot import Robot
from .playback import Playback
from .shapes import Shape, reach

FRAME_S = 1.0 / 30.0
"""Time (s) between two drawn poses: the rate of a film, which a local page can follow."""
GHOST_OPACITY = 0.3
"""Opacity of the second motion: the first one shows through it."""
HIDDEN_AT_FIRST = ("capsules", "prior", "prior: centres of mass")
"""Layers that are hidden at first beside an estimate, since they would cover it; the first one is always hidden at first."""
VIEWED_FROM = (0.9, -1.1, 0.7)
"""Direction from the robot to the camera: from the front and above, so that no axis of the base points at it."""
CAMERA_DISTANCE = 1.25
"""Distance of the camera, over the diagonal of the box around the robot: the box fits into viser's angle of view of 75 degrees."""
FULL_COLOUR_SHARE = 0.1
"""Residual, as a share of the largest torque, that is drawn in full colour."""


class Page:
    """A robot in a browser, with its motions.

    Parameters
    ----------
    robot : Robot
        Robot with its frames.
    shapes : sequence of Shape
        Shapes on its links.
    playbacks : sequence of Playback
        Motions of the robot and of a second, transparent one.
    host, port : str, int
        Address of the server.

    Raises
    ------
    PlotError
        Without viser, or if the port is in use.
    """

    def __init__(
        self,
        robot: Robot,
        shapes: Sequence[Shape],
        playbacks: Sequence[Playback],
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        self.robot, self.playbacks = robot, tuple(playbacks[:2])
        self._server = _server(host, port, robot.name)
        self._nodes: list[list[Any]] = []
        self._layers: dict[str, list[Any]] = {}
        self._coloured: dict[int, list[Any]] = {}
        self._points: list[tuple[int, Array]] = []
        gravity = np.array(robot.geometry.gravity)
        size = reach(robot)
        scene = self._server.scene
        scene.set_up_direction(tuple(_up(gravity)))
        scene.add_grid(
            "/floor", width=4.0 * size, height=4.0 * size, cell_size=0.1 * size, section_size=0.5 * size
        )
        if np.any(gravity):
            start = np.array([-0.6 * size, -0.6 * size, 0.0]) - 0.4 * size * gravity / np.linalg.norm(gravity)
            ends = np.stack([start, start + 0.35 * size * gravity / np.linalg.norm(gravity)])
            arrow = scene.add_arrows(
                "/gravity",
                ends[None],
                (213, 94, 0),
                shaft_radius=0.008 * size,
                head_radius=0.02 * size,
                head_length=0.05 * size,
            )
            self._layers["gravity"] = [arrow]
        self._add_robot("", shapes, ghost=False)
        if len(self.playbacks) > 1:
            self._add_robot(
                "/ghost", [shape for shape in shapes if shape.layer in ("skeleton", "visuals")], ghost=True
            )
        self._controls()
        self.show(0.0)
        self._look_at_robot()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    @property
    def duration(self) -> float:
        """Duration of the motions (s); zero without one."""
        return max((float(playback.t[-1] - playback.t[0]) for playback in self.playbacks), default=0.0)

    def show(self, seconds: float) -> None:
        """Draw the robot, its ghost and its residual at a time after the start of the motions (s)."""
        poses = [playback.at(playback.t[0] + seconds) for playback in self.playbacks] or [
            np.zeros(self.robot.n_dof)
        ]
        with self._server.atomic():
            for nodes, q in zip(self._nodes, poses, strict=False):
                for node, matrix in zip(nodes, frames(self.robot, q[None])[0], strict=True):
                    node.position, node.wxyz = _place(matrix)
            shares = (
                self.playbacks[0].residual_at(self.playbacks[0].t[0] + seconds) if self.playbacks else None
            )
            if shares is not None:
                for link, handles in self._coloured.items():
                    for handle in handles:
                        handle.color = _heat(float(abs(shares[link - 1])))

    def play(self) -> None:
        """Serve the page until Ctrl-C, and move the robot while "play" is checked."""
        try:
            last = time.monotonic()
            while True:
                time.sleep(FRAME_S)
                now = time.monotonic()
                if self.duration > 0.0 and self._playing.value:
                    moved = self._slider.value + (now - last) * float(self._speed.value)
                    self._slider.value = moved % self.duration
                last = now
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """End the server."""
        self._server.stop()

    def _look_at_robot(self) -> None:
        """Place the camera so that all shapes of the first pose are in the picture."""
        q = self.playbacks[0].at(self.playbacks[0].t[0]) if self.playbacks else np.zeros(self.robot.n_dof)
        at = frames(self.robot, q[None])[0]
        points = np.concatenate([at[:, :3, 3], *(_moved(at[link], points) for link, points in self._points)])
        low, high = points.min(axis=0), points.max(axis=0)
        middle = 0.5 * (low + high)
        away = np.array(VIEWED_FROM) / np.linalg.norm(VIEWED_FROM)
        camera = self._server.initial_camera
        # The frames of one joint are all in one place: a camera there would look at itself.
        size = max(float(np.linalg.norm(high - low)), reach(self.robot))
        camera.position = tuple(middle + CAMERA_DISTANCE * size * away)
        camera.look_at = tuple(middle)

    def _add_robot(self, root: str, shapes: Sequence[Shape], *, ghost: bool) -> None:
        scene = self._server.scene
        nodes = [
            scene.add_frame(f"{root}/link_{link}", show_axes=False) for link in range(self.robot.n_dof + 1)
        ]
        self._nodes.append(nodes)
        for number, shape in enumerate(shapes):
            handle = self._add(
                f"{root}/link_{shape.link}/{number}", shape, GHOST_OPACITY if ghost else shape.opacity
            )
            if handle is None:
                continue
            if shape.kind == "ellipsoid":
                axes = np.diag(shape.size)
                self._points.append((shape.link, _moved(shape.pose, np.concatenate([axes, -axes]))))
            self._layers.setdefault("simulated" if ghost else shape.layer, []).append(handle)
            if not ghost and shape.layer == "skeleton" and shape.kind in ("sphere", "box") and shape.link > 0:
                self._coloured.setdefault(shape.link, []).append(handle)

    def _add(self, name: str, shape: Shape, opacity: float) -> Any:
        scene = self._server.scene
        position, wxyz = _place(shape.pose)
        at: dict[str, Any] = {"position": position, "wxyz": wxyz}
        look: dict[str, Any] = {**at, "color": shape.colour, "opacity": None if opacity >= 1.0 else opacity}
        if shape.kind == "cylinder":
            return scene.add_cylinder(name, radius=shape.size[0], height=shape.size[1], **look)
        if shape.kind == "sphere":
            return scene.add_icosphere(name, radius=shape.size[0], **look)
        if shape.kind == "ellipsoid":
            return scene.add_icosphere(name, radius=1.0, scale=shape.size, **look)
        if shape.kind == "box":
            return scene.add_box(name, dimensions=shape.size, **look)
        return self._add_mesh(name, shape, look)

    def _add_mesh(self, name: str, shape: Shape, look: dict[str, Any]) -> Any:
        import trimesh

        try:
            mesh: Any = trimesh.load(shape.file, force="mesh")
        except Exception as reason:  # any error of a mesh reader: the other shapes are still shown
            self._server.gui.add_markdown(f"Mesh {shape.file} cannot be read: {reason}")
            return None
        vertices = np.asarray(mesh.vertices) * np.array(shape.size)
        self._points.append((shape.link, _moved(shape.pose, vertices)))
        return self._server.scene.add_mesh_simple(
            name, vertices, np.asarray(mesh.faces), **{**look, "color": (188, 194, 203)}
        )

    def _controls(self) -> None:
        gui = self._server.gui
        dark = gui.add_checkbox("dark page", initial_value=False)
        dark.on_update(lambda _: gui.configure_theme(dark_mode=dark.value))
        if self.duration > 0.0:
            self._playing = gui.add_checkbox("play", initial_value=False)
            self._slider = gui.add_slider("time, s", 0.0, self.duration, min(0.01, self.duration), 0.0)
            self._speed = gui.add_dropdown("speed", ("0.25", "0.5", "1", "2"), initial_value="1")
            self._slider.on_update(lambda _: self.show(float(self._slider.value)))
        hidden = HIDDEN_AT_FIRST if "estimate" in self._layers else HIDDEN_AT_FIRST[:1]
        for layer, handles in self._layers.items():
            shown = gui.add_checkbox(layer, initial_value=layer not in hidden)
            _show_all(handles, visible=shown.value)
            shown.on_update(lambda event, handles=handles: _show_all(handles, visible=event.target.value))


def _show_all(handles: Sequence[Any], *, visible: bool) -> None:
    for handle in handles:
        handle.visible = visible


def _place(matrix: Array) -> tuple[Array, Array]:
    """Return position and quaternion (w first) of a homogeneous matrix."""
    return matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_quat()[[3, 0, 1, 2]]


def _moved(matrix: Array, points: Array) -> Array:
    """Return points (k, 3) of a frame in the frame that its homogeneous matrix refers to (m)."""
    moved: Array = points @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def _up(gravity: Array) -> Array:
    """Return the upward direction of a picture: against gravity, or z without it."""
    size = float(np.linalg.norm(gravity))
    return np.array([0.0, 0.0, 1.0]) if size == 0.0 else -gravity / size


def _heat(share: float) -> tuple[int, int, int]:
    """Return grey for no residual, orange from `FULL_COLOUR_SHARE` of the largest torque on."""
    part = min(share / FULL_COLOUR_SHARE, 1.0)
    grey, full = np.array([70.0, 78.0, 90.0]), np.array([213.0, 94.0, 0.0])
    red, green, blue = (grey + part * (full - grey)).round().astype(int).tolist()
    return red, green, blue


def _server(host: str, port: int, label: str) -> Any:
    viser = optional("viser", PlotError, "didim view needs viser: pip install 'didim[view]'")
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # its banner, which would interrupt a printed result
            return viser.ViserServer(host=host, port=port, label=label, verbose=False)
    except OSError as reason:
        raise PlotError(
            f"port {port} cannot be used: {reason.strerror or reason}; --port names another"
        ) from None
