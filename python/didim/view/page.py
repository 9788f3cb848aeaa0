"""Shapes and motions on a page of viser, which includes the page's files. Tested in ``tests/test_view.py``."""

from __future__ import annotations

import contextlib
import io
import socket
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.plugins import optional
from ..errors import PlotError
from ..model.kinematics import frames
from ..robot.rigid_body import pose, quaternion
from ..robot.robot import Robot
from .framing import box_around, box_of, camera, floor_axes, points_in, poses_of
from .playback import Playback
from .shapes import FLOOR, GRAVITY, LINK, Shape, reach

FRAME_S = 1.0 / 30.0
"""Time (s) between two drawn poses: the rate of a film, which a local page can follow."""
GHOST_OPACITY = 0.3
"""Opacity of the second motion: the first one shows through it."""
HIDDEN_AT_FIRST = ("capsules", "prior", "prior: centres of mass")
"""Layers that are hidden at first beside an estimate, since they would cover it; the first one is always hidden at first."""
ARROW_SHARE = 0.35
"""Length of the arrow of gravity, as a share of the robot's reach."""
FOLLOW_SCHEME = """\
<img src="data:," hidden onerror="
  const dark = matchMedia('(prefers-color-scheme: dark)');
  const follow = () => {
    if (dark.matches == /darkMode/.test(location.search)) return;
    location.replace(dark.matches ? '?darkMode' : '?');
  };
  dark.onchange = follow;
  follow();
">"""
"""HTML that opens viser's dark page (its address ends in ``?darkMode``) in a browser whose user prefers dark pages.

viser has no setting for it. A picture that cannot be loaded runs its handler; a script element would not run.
"""
UPRIGHT_SHARE = 0.6
"""Upper share of an upright screen that the panel leaves free."""
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
        self._boxes: list[tuple[int, Array]] = []
        self._axes = floor_axes(np.array(robot.geometry.gravity))
        self._server.scene.set_up_direction(tuple(self._axes[:, 2]))
        self._add_robot("", shapes, ghost=False)
        if len(self.playbacks) > 1:
            self._add_robot(
                "/ghost", [shape for shape in shapes if shape.layer in ("skeleton", "visuals")], ghost=True
            )
        self._points = points_in(robot, poses_of(robot, self.playbacks), self._boxes)
        self._add_surroundings()
        self._controls()
        self.show(0.0)
        self._server.on_client_connect(self._look_at_robot)

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

    def _look_at_robot(self, client: Any) -> None:
        """Place the camera of a browser so that the robot is in its picture in all poses."""
        aspect = client.camera.aspect
        free = 1.0 if aspect > 1.0 else UPRIGHT_SHARE  # viser's panel covers the rest of a phone's screen
        position, look_at = camera(self._points, self._axes, client.camera.fov, aspect, free)
        with client.atomic():
            client.camera.position, client.camera.look_at = position, look_at

    def _add_surroundings(self) -> None:
        """Add the floor, under the base and all poses, and the arrow of gravity at a corner of it."""
        size, scene = reach(self.robot), self._server.scene
        low, high = (end(self._points @ self._axes, axis=0) for end in (np.min, np.max))
        middle = np.array([*(0.5 * (low + high))[:2], min(low[2], 0.0)])
        wide = max(4.0 * size, 2.0 * float((high - low)[:2].max()))
        turned = pose(self._axes, self._axes @ middle)
        position, wxyz = _place(turned)
        scene.add_grid(
            "/floor",
            width=wide,
            height=wide,
            cell_size=0.1 * size,
            section_size=0.5 * size,
            cell_color=FLOOR,
            section_color=FLOOR,
            cell_thickness=0.5,
            position=position,
            wxyz=wxyz,
        )
        if not np.any(self.robot.geometry.gravity):
            return
        end = self._axes @ np.array([low[0], low[1], middle[2] + 0.05 * size])
        start = end + ARROW_SHARE * size * self._axes[:, 2]
        self._points = np.concatenate([self._points, [start, end]])
        arrow = scene.add_arrows(
            "/gravity",
            np.stack([start, end])[None],
            GRAVITY,
            shaft_radius=0.008 * size,
            head_radius=0.02 * size,
            head_length=0.05 * size,
        )
        label = scene.add_label("/gravity_label", "gravity", position=start, anchor="bottom-center")
        self._layers = {"gravity": [arrow, label], **self._layers}

    def _add_robot(self, root: str, shapes: Sequence[Shape], *, ghost: bool) -> None:
        scene = self._server.scene
        nodes = [
            scene.add_frame(f"{root}/link_{link}", show_axes=False) for link in range(self.robot.n_joints + 1)
        ]
        self._nodes.append(nodes)
        for number, shape in enumerate(shapes):
            handle = self._add(
                f"{root}/link_{shape.link}/{number}", shape, GHOST_OPACITY if ghost else shape.opacity
            )
            if handle is None:
                continue
            if shape.kind != "mesh":
                self._boxes.append((shape.link, box_of(shape)))
            self._layers.setdefault("simulated" if ghost else shape.layer, []).append(handle)
            driven = 0 < shape.link <= self.robot.n_dof
            if driven and not ghost and shape.layer == "skeleton" and shape.kind in ("sphere", "box"):
                self._coloured.setdefault(shape.link, []).append(handle)

    def _add(self, name: str, shape: Shape, opacity: float) -> Any:
        scene = self._server.scene
        position, wxyz = _place(shape.pose)
        look: dict[str, Any] = {
            "position": position,
            "wxyz": wxyz,
            "color": shape.colour,
            "opacity": None if opacity >= 1.0 else opacity,
        }
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
        self._boxes.append((shape.link, box_around(vertices, shape.pose)))
        return self._server.scene.add_mesh_simple(name, vertices, np.asarray(mesh.faces), **look)

    def _controls(self) -> None:
        gui = self._server.gui
        gui.add_html(FOLLOW_SCHEME)
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
    return matrix[:3, 3], quaternion(matrix[:3, :3])


def _heat(share: float) -> tuple[int, int, int]:
    """Return grey for no residual, orange from `FULL_COLOUR_SHARE` of the largest torque on."""
    part = min(share / FULL_COLOUR_SHARE, 1.0)
    grey, full = np.array(LINK), np.array(GRAVITY)
    red, green, blue = (grey + part * (full - grey)).round().astype(int).tolist()
    return red, green, blue


def _server(host: str, port: int, label: str) -> Any:
    viser = optional("viser", PlotError, "didim view needs viser: pip install 'didim[view]'")
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),  # its banner, which would interrupt a printed result
            _of_own_pages(host) as limited,
        ):
            server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
        if not limited:
            server.stop()
            raise PlotError(
                "this version of viser opens its socket to pages of any origin: pip install --upgrade viser"
            )
        return server
    except OSError as reason:
        raise PlotError(
            f"port {port} cannot be used: {reason.strerror or reason}; --port names another"
        ) from None


@contextlib.contextmanager
def _of_own_pages(host: str) -> Iterator[list[int]]:
    """Let a server that viser starts refuse the sockets of pages of another origin; yield the ports of servers that do.

    A browser lets any page open a socket to this machine, and names the page's origin. viser accepts all, and has no setting.
    """
    from websockets.asyncio import server

    serve, limited = server.serve, list[int]()

    def serve_own(handler: Any, address: str, port: int, **options: Any) -> Any:
        limited.append(port)
        names = dict.fromkeys((host, address, "127.0.0.1", "localhost", "[::1]", socket.gethostname()))
        own = [*(f"http://{name}:{port}" for name in names), None]  # None: a program, which says no origin
        return serve(handler, address, port, **{**options, "origins": own})

    server.serve = serve_own  # type: ignore[assignment,misc]
    try:
        yield limited
    finally:
        server.serve = serve  # type: ignore[misc]
