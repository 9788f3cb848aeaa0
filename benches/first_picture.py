"""Pictures of the README and the home page: `python benches/first_picture.py` writes them to docs/img.

`first.png` runs the commands of the packaged example `ur10e` in an empty folder and draws what goes in, the arm, and what comes
out: the torque that holds the arm, of the old URDF and of the new one beside the robot that made the log. `motion.gif` is the
motion that `didim excite tx40` designs, at its own speed.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import runpy
import tempfile
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from PIL import Image

import didim
from didim._tools.arrays import Array
from didim.cli.lists import example_commands
from didim.cli.main import main as didim_command
from didim.model.kinematics import frames
from didim.plot.skeleton import skeleton
from didim.plot.style import MODEL, RESIDUAL

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "img"
INK = "#707a86"
"""Colour of letters, axes and links. The pictures have no background: its contrast is 4.3 on white and on GitHub's dark page."""
POSE = (-0.6, -1.2, 1.4, -0.8, -1.2, 0.0)
"""Pose of the drawn UR10e (rad): elbow up, so that no link hides another."""
AXIS_SHARE = 0.15
"""Half the length of a drawn joint axis, as a share of half the drawn cube."""
FRAMES_PER_S = 12
"""Frames of the animation in a second: a browser's GIFs are smooth enough, and the file stays below 400 kB."""
SECONDS = 4.0
"""Length of the animation (s)."""


def example(folder: Path) -> tuple[didim.Robot, didim.Robot, Array]:
    """Run the example's commands in a folder; return the old robot, the new one, and the truth's standard parameters, (c,)."""
    for command in (f"example ur10e -o {folder}", *example_commands("ur10e")):
        program, *words = command.removeprefix("didim ").split()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            if program == "python":
                runpy.run_path(words[0], run_name="__main__")
            elif didim_command([program, *words]) != 0:
                raise SystemExit(f"{command} failed")
        os.chdir(folder)
    old, new = didim.load_robot("ur10e.urdf"), didim.load_robot("ur10e_new.urdf")
    return old, new, runpy.run_path("make_logs.py")["true_parameters"](old)


def gravity_errors(robot: didim.Robot, truth: didim.Robot, parameters: Array) -> tuple[Array, float]:
    """Return the rms error of each joint's gravity torque (N.m), (n_dof,), and the error of all as a share, at 200 poses."""
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (200, truth.n_dof))
    rest = np.zeros_like(q)
    bodies = [not name.startswith(("Ia", "F", "Off")) for name in truth.parameter_names]
    expected = didim.inverse_dynamics(truth, q, rest, rest, parameters * bodies)
    error = didim.inverse_dynamics(robot, q, rest, rest, robot.parameter_set("urdf") * bodies) - expected
    return np.sqrt(np.mean(error**2, axis=0)), float(np.linalg.norm(error) / np.linalg.norm(expected))


def draw_arm(axes: Axes3D, robot: didim.Robot, q: Array, half_m: float, middle_m: Array) -> None:
    """Draw the links and joint axes of a robot in a pose, within a cube of twice `half_m` around `middle_m`."""
    points, directions = skeleton(robot, q)
    origins = frames(robot, q[None])[0, 1:, :3, 3]
    axes.plot(*points.T, color=INK, linewidth=7.0, solid_capstyle="round", solid_joinstyle="round")
    for origin, z in zip(origins, directions, strict=True):
        ends = np.stack([origin - AXIS_SHARE * half_m * z, origin + AXIS_SHARE * half_m * z])
        axes.plot(*ends.T, color=MODEL, linewidth=2.0)
    axes.plot(*points[:1].T, marker="s", markersize=13, color=INK, linestyle="none")
    axes.plot(*origins.T, marker="o", markersize=4, color="white", markeredgecolor=INK, linestyle="none")
    for limit, middle in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle_m, strict=True):
        limit(middle - half_m, middle + half_m)
    axes.set_box_aspect((1, 1, 1), zoom=1.5)
    axes.set_axis_off()


def picture(folder: Path) -> Figure:
    """Draw what goes in, the arm, and the gravity torques of the old and the new URDF."""
    old, new, parameters = example(folder)
    log = didim.load_experiment("log.toml").recordings[0]
    assert log.tau is not None
    before, share_before = gravity_errors(old, old, parameters)
    after, share_after = gravity_errors(new, old, parameters)
    figure = Figure(figsize=(10.4, 3.9))
    grid = figure.add_gridspec(
        2,
        3,
        width_ratios=(1.0, 0.95, 1.15),
        hspace=0.3,
        wspace=0.12,
        left=0.05,
        right=0.985,
        top=0.8,
        bottom=0.13,
    )
    shown = (log.t > 2.0) & (log.t < 8.0)
    for row, (values, label) in enumerate(((log.q, "position, rad"), (log.tau, "torque, N m"))):
        axes = figure.add_subplot(grid[row, 0])
        axes.plot(log.t[shown], values[shown][:, 1:4], linewidth=0.9)
        axes.set_title(label, fontsize=9, loc="left", pad=3)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
        if row == 0:
            axes.set_xticklabels([])
    axes.set_xlabel("time, s", fontsize=9)
    arm: Any = figure.add_subplot(grid[:, 1], projection="3d")
    corners, _ = skeleton(old, np.array(POSE))
    low, high = corners.min(axis=0), corners.max(axis=0)
    draw_arm(arm, old, np.array(POSE), 0.62 * float((high - low).max()), 0.5 * (low + high))
    arm.view_init(elev=15, azim=-100)
    bars = figure.add_subplot(grid[:, 2])
    joints = np.arange(2, old.n_dof + 1)
    bars.bar(joints - 0.2, before[1:], width=0.38, color=RESIDUAL, label="URDF of the maker")
    bars.bar(joints + 0.2, after[1:], width=0.38, color=MODEL, label="URDF that didim wrote")
    for joint in joints:
        old_text, new_text = f"{before[joint - 1]:.2g}", f"{after[joint - 1]:.1g}"
        bars.text(joint - 0.2, before[joint - 1] + 0.1, old_text, ha="center", fontsize=8, color=RESIDUAL)
        bars.text(joint + 0.03, after[joint - 1] + 0.1, new_text, ha="left", fontsize=8, color=MODEL)
    bars.set_xticks(joints, [f"joint {joint}" for joint in joints], fontsize=8)
    bars.set_ylabel("rms error of the gravity torque, N m", fontsize=9)
    bars.tick_params(labelsize=8)
    bars.spines[["top", "right"]].set_visible(False)
    bars.legend(frameon=False, fontsize=9, loc="upper right")
    heads = (
        (0.05, "In: a URDF and a log", "ur10e.urdf, log.csv"),
        (0.385, "didim identify", "a UR10e with an undeclared tool"),
        (
            0.655,
            "Out: the URDF of your robot",
            f"gravity torques {100 * share_before:.0f} % off before, {100 * share_after:.1f} % after",
        ),
    )
    for x, title, line in heads:
        figure.text(x, 0.935, title, fontsize=13, fontweight="bold")
        figure.text(x, 0.88, line, fontsize=10)
    return figure


def animation(folder: Path) -> list[Image.Image]:
    """Return pictures of the motion that `didim excite tx40` designs, with the path of the last frame."""
    os.chdir(folder)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        if didim_command(["excite", "tx40", "-o", "motion.csv"]) != 0:
            raise SystemExit("didim excite failed")
    rows = np.genfromtxt("motion.csv", delimiter=",", names=True)
    names = rows.dtype.names or ()
    robot = didim.load_robot("tx40")
    t = rows[names[0]]
    q = np.stack([rows[name] for name in names[1 : 1 + robot.n_dof]], axis=1)
    every = np.searchsorted(t, np.arange(0.0, min(SECONDS, t[-1]), 1.0 / FRAMES_PER_S))
    way = frames(robot, q[: every[-1] + 1])[:, -1, :3, 3]
    figure = Figure(figsize=(3.4, 3.4), dpi=100)
    figure.subplots_adjust(0, 0, 1, 1)
    axes: Any = figure.add_subplot(projection="3d")

    pictures: list[Image.Image] = []
    for index in every.tolist():
        axes.clear()
        axes.plot(*way[: index + 1 : 4].T, color=RESIDUAL, linewidth=0.8, alpha=0.8)
        draw_arm(axes, robot, q[index], 0.33, np.array([0.0, 0.0, 0.1]))
        data = io.BytesIO()
        figure.savefig(data, transparent=True)
        pictures.append(Image.open(data))
    return pictures


def main() -> None:
    """Write both pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("first", "motion"))
    only = parser.parse_args().only
    inked = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
    style: dict[Any, Any] = {"font.family": "DejaVu Sans", **dict.fromkeys(inked, INK)}
    mpl.rcParams.update(style)
    with tempfile.TemporaryDirectory() as name:
        if only != "motion":
            picture(Path(name) / "ur10e").savefig(IMAGES / "first.png", dpi=150, transparent=True)
        if only != "first":
            first, *rest = animation(Path(name))
            # Each picture takes the place of the one before: without a background it would show through.
            first.save(
                IMAGES / "motion.gif",
                save_all=True,
                append_images=rest,
                duration=round(1000 / FRAMES_PER_S),
                loop=0,
                disposal=2,
            )
        os.chdir(IMAGES)


if __name__ == "__main__":
    main()
