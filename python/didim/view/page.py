"""Shapes and motions on a page of viser, which includes the page's files, with all poses in the picture.

Tested in ``tests/test_view.py``.
"""

from __future__ import annotations

import contextlib
import io
import itertools
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
from .playback import Playback
from .shapes import FLOOR, GRAVITY, LINK, Shape, reach

HIDDEN_AT_FIRST = ("capsules", "prior", "prior: centres of mass")
"""Layers that are hidden at first beside an estimate, since they would cover it; the first one is always hidden at first."""
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
                # Time (s) between two drawn poses: the rate of a film, which a local page can follow.
                time.sleep(1.0 / 30.0)
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
        # Upper share of an upright screen that the panel leaves free.
        free = 1.0 if aspect > 1.0 else 0.6  # viser's panel covers the rest of a phone's screen
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
        # Length of the arrow of gravity, as a share of the robot's reach.
        start = end + 0.35 * size * self._axes[:, 2]
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
                # Opacity of the second motion: the first one shows through it.
                f"{root}/link_{shape.link}/{number}",
                shape,
                0.3 if ghost else shape.opacity,
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


MARGIN = 1.25
"""Distance of the camera over the smallest one from which all points are in the picture."""
MOST_POSES = 60
"""Largest number of poses of a motion that the picture must hold: enough for a path without gaps wider than a link."""


def floor_axes(gravity: Array) -> Array:
    """Return the axes of the floor as columns, (3, 3): two level ones, and up, which is z without gravity."""
    size = float(np.linalg.norm(gravity))
    up = np.array([0.0, 0.0, 1.0]) if size == 0.0 else -gravity / size
    # The level axis nearest to x, or to y for a robot whose x axis is upright.
    along = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
    x = along - (along @ up) * up
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up], axis=1)


def poses_of(robot: Robot, playbacks: Sequence[Playback]) -> Array:
    """Return poses of all motions, (n_poses, n_dof), at most `MOST_POSES` of each; position zero without a motion."""
    thinned = [
        playback.q[np.linspace(0, len(playback.q) - 1, MOST_POSES).round().astype(int)]
        for playback in playbacks
    ]
    return np.concatenate(thinned or [np.zeros((1, robot.n_dof))])


def box_of(shape: Shape) -> Array:
    """Return the corners of a box around a shape in the frame of its link, (8, 3) (m); a mesh needs its vertices."""
    if shape.kind == "cylinder":
        half = np.array([shape.size[0], shape.size[0], 0.5 * shape.size[1]])
    elif shape.kind == "box":
        half = 0.5 * np.array(shape.size)
    else:
        half = np.broadcast_to(np.array(shape.size), 3)
    return box_around(np.stack([-half, half]), shape.pose)


def box_around(points: Array, pose: Array) -> Array:
    """Return the corners, (8, 3), of the box around points (k, 3), moved by a pose (4, 4) (m)."""
    corners = np.array(list(itertools.product(*np.stack([points.min(axis=0), points.max(axis=0)], axis=1))))
    moved: Array = corners @ pose[:3, :3].T + pose[:3, 3]
    return moved


def points_in(robot: Robot, q: Array, boxes: Sequence[tuple[int, Array]]) -> Array:
    """Return the origins of all frames and the corners of the links' boxes in all poses, (k, 3), in frame 0 (m)."""
    at = frames(robot, q)
    parts = [at[:, :, :3, 3].reshape(-1, 3)]
    for link, corners in boxes:
        matrix = at[:, link]
        parts.append((corners @ matrix[:, :3, :3].swapaxes(1, 2) + matrix[:, None, :3, 3]).reshape(-1, 3))
    return np.concatenate(parts)


def camera(
    points: Array, axes: Array, angle: float, aspect: float, share: float = 1.0
) -> tuple[Array, Array]:
    """Return the position of a camera that sees all points, and the point that it looks at, both (3,).

    Parameters
    ----------
    points : (k, 3) array
        Points (m), which are not all in one place.
    axes : (3, 3) array
        Axes of the floor, as columns.
    angle : float
        Vertical angle of view (rad).
    aspect : float
        Width of the picture over its height.
    share : float
        Upper share of the picture in which the points are; the rest may be covered.
    """
    # Direction from the robot to the camera along the axes of the floor: from the front and above, so no level axis points at
    # it.
    away = axes @ np.array((0.9, -1.1, 0.7))
    away /= np.linalg.norm(away)
    right = np.cross(axes[:, 2], away)
    right /= np.linalg.norm(right)
    seen = np.stack([right, np.cross(away, right), away], axis=1)
    placed = points @ seen
    middle = 0.5 * (placed.min(axis=0) + placed.max(axis=0))
    x, y, depth = (placed - middle).T
    slope = float(np.tan(0.5 * angle))
    sides = np.abs(x) / aspect / slope + depth
    above, below = (y / slope + depth) / share, (-y / slope - (1.0 - 2.0 * share) * depth) / share
    distance = float(np.max([sides, above, below]))
    look_at: Array = seen @ (middle - (0.0, (1.0 - share) * slope * MARGIN * distance, 0.0))
    return look_at + MARGIN * distance * away, look_at
