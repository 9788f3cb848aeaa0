"""Robots by their maker's standard table: the same mechanics as the table says, and parameters in its frames both ways."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim.cli.main import main
from didim.robot.robot_text import robot_text

Array = NDArray[np.float64]

TABLE = (  # a, d, alpha deg, theta deg: no zero, so that nothing can hide
    (0.11, 0.32, 90.0, 20.0),
    (-0.4, 0.05, -35.0, -10.0),
    (0.07, -0.12, 70.0, 40.0),
    (-0.03, 0.26, -90.0, 5.0),
)
GRAVITY = (1.0, -2.0, -9.4)


def arm_text(extra: str = "") -> str:
    rows = "".join(
        f'[[joint]]\nkind = "revolute"\na_m = {a}\nd_m = {d}\nalpha_deg = {alpha}\ntheta_deg = {theta}\n'
        for a, d, alpha, theta in TABLE
    )
    return f'schema = 1\nconvention = "dh"\ngravity_m_s2 = {list(GRAVITY)}\n{rows}{extra}'


def arm(folder: Path, extra: str = "") -> didim.Robot:
    path = folder / "arm.toml"
    path.write_text(arm_text(extra), encoding="utf-8")
    return didim.load_robot(path)


def frames(q: Array) -> list[Array]:
    """Frames of the table as a textbook has them: Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha)."""
    found, frame = [], np.eye(4)
    for (a, d, alpha, theta), position in zip(TABLE, q, strict=True):
        turn, twist = math.radians(theta) + position, math.radians(alpha)
        about_z, about_x, shift = np.eye(4), np.eye(4), np.eye(4)
        about_z[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
        about_x[1:3, 1:3] = [[math.cos(twist), -math.sin(twist)], [math.sin(twist), math.cos(twist)]]
        shift[:3, 3] = [a, 0.0, d]
        frame = frame @ about_z @ shift @ about_x
        found.append(frame)
    return found


def bodies() -> list[tuple[float, Array, Array]]:
    """Mass, centre and inertia about the centre of each link, in its frame of the table."""
    rng = np.random.default_rng(4)
    found = []
    for _ in TABLE:
        a = rng.normal(size=(3, 3))
        found.append((rng.uniform(0.5, 3.0), rng.normal(0.0, 0.1, 3), 0.02 * (a @ a.T + 3.0 * np.eye(3))))
    return found


def maker_parameters(robot: didim.Robot) -> Array:
    """The bodies as standard parameters in the frames of the table: moments about the origin of the frame."""
    x = np.zeros(len(robot.parameter_names))
    for j, (mass, centre, inertia) in enumerate(bodies()):
        origin = inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        first = robot.parameter_names.index(f"XX{j + 1}")
        x[first : first + 10] = [*origin[np.triu_indices(3)], *(mass * centre), mass]
    return x


def potential(q: Array) -> float:
    return -sum(
        mass * float(np.array(GRAVITY) @ (frame @ [*centre, 1.0])[:3])
        for frame, (mass, centre, _) in zip(frames(q), bodies(), strict=True)
    )


def kinetic(q: Array, dq: Array) -> float:
    """Kinetic energy, by differences of the frames."""
    step = 1e-6
    energy = 0.0
    for before, now, after, (mass, centre, inertia) in zip(
        frames(q - step * dq), frames(q), frames(q + step * dq), bodies(), strict=True
    ):
        rate = (after - before) / (2.0 * step)
        speed = (rate @ [*centre, 1.0])[:3]
        spin = now[:3, :3].T @ rate[:3, :3]
        omega = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        energy += 0.5 * mass * float(speed @ speed) + 0.5 * float(omega @ inertia @ omega)
    return energy


def test_energies_are_those_of_the_makers_table(tmp_path: Path) -> None:
    """The torques at rest are the gradient of the potential, and the inertia matrix gives the kinetic energy."""
    robot = arm(tmp_path)
    x = robot.from_own_frames(maker_parameters(robot))
    rng = np.random.default_rng(0)
    rest = np.zeros((1, 4))
    for _ in range(10):
        q, dq = rng.uniform(-3.0, 3.0, 4), rng.uniform(-2.0, 2.0, 4)
        steps = 1e-5 * np.eye(4)
        gradient = [(potential(q + step) - potential(q - step)) / 2e-5 for step in steps]
        tau = didim.inverse_dynamics(robot, q[None], rest, rest, x)[0]
        np.testing.assert_allclose(tau, gradient, atol=1e-8 * np.abs(gradient).max() + 1e-7)
        inertia = didim.inertia_matrix(robot, q[None], x)[0]
        assert 0.5 * dq @ inertia @ dq == pytest.approx(kinetic(q, dq), rel=1e-6)


def test_both_directions_and_a_set_in_own_frames(tmp_path: Path) -> None:
    robot = arm(tmp_path)
    own = maker_parameters(robot)
    np.testing.assert_allclose(robot.to_own_frames(robot.from_own_frames(own)), own, rtol=0, atol=1e-14)
    lines = [f"{name} = {value!r}" for name, value in zip(robot.parameter_names, own.tolist(), strict=True)]
    robot = arm(tmp_path, "\n".join(["[parameters.maker]", 'frames = "own"', *lines]))
    np.testing.assert_allclose(robot.parameter_set("maker"), robot.from_own_frames(own), atol=1e-15)
    # Written and read again: the same rows, the same set, to the last digit.
    path = tmp_path / "again.toml"
    path.write_text(robot_text(robot), encoding="utf-8")
    again = didim.load_robot(path)
    assert again.geometry == robot.geometry
    assert again.standard == robot.standard
    np.testing.assert_array_equal(again.parameter_set("maker"), robot.parameter_set("maker"))


def test_a_urdf_has_own_frames_too(shared: Path) -> None:
    """Masses and centres of the links of a URDF come back from the set that was made of them."""
    robot = didim.load_robot(shared / "data" / "ur10e" / "ur10e.urdf")
    x = robot.to_own_frames(robot.parameter_set("urdf"))
    at = robot.parameter_names.index
    text = (shared / "data" / "ur10e" / "ur10e.urdf").read_text()
    forearm = text.split('<link name="forearm_link">')[1].split("</link>")[0]
    mass = float(forearm.split('<mass value="')[1].split('"')[0])
    centre = [float(v) for v in forearm.split("<inertial>")[1].split('xyz="')[1].split('"')[0].split()]
    assert x[at("M3")] == pytest.approx(mass)
    np.testing.assert_allclose([x[at(f"M{k}3")] / mass for k in "XYZ"], centre, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("a_m = 0.11\n", "", "key 'a_m' is missing: with convention = 'dh' a_m is the length along x and d_m"),
        ("a_m = 0.11", "a = 0.11", "unknown key 'a'; units are part of the keys: a_m"),
        ("alpha_deg = 90.0", "alpha = 90.0", "unknown key 'alpha'; units are part of the keys: alpha_deg or alpha_rad"),
        ("a_m = 0.11", "r_m = 0.11", "r_m belongs to convention 'mdh'"),
        ("d_m = 0.32\n", "", "key 'd_m' is missing"),
        ('"dh"', '"mdh"', "unknown key 'a_m'"),
    ],
)  # fmt: skip
def test_the_keys_of_the_two_conventions_do_not_mix(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(arm_text().replace(old, new, 1), encoding="utf-8")
    with pytest.raises(didim.errors.RobotError, match=message):
        didim.load_robot(path)


def test_wrong_sets_and_parameters(tmp_path: Path) -> None:
    with pytest.raises(
        didim.errors.RobotError, match=r"'ZZ1R' is a base parameter, which frames = 'own' cannot have"
    ):
        arm(tmp_path, '[parameters.a]\nframes = "own"\nZZ1R = 1.0\n')
    with pytest.raises(didim.errors.RobotError, match="frames must be one of 'model', 'own'"):
        arm(tmp_path, '[parameters.a]\nframes = "dh"\n')
    plain = 'schema = 1\n[[joint]]\nkind = "revolute"\n[parameters.a]\nframes = "own"\n'
    (tmp_path / "plain.toml").write_text(plain)
    with pytest.raises(didim.errors.RobotError, match="frames = 'own' is for a robot with convention = 'dh'"):
        didim.load_robot(tmp_path / "plain.toml")
    with pytest.raises(
        didim.errors.RobotError, match=r"parameters must have shape \(56,\) for robot 'arm', got \(3,\)"
    ):
        arm(tmp_path).to_own_frames([1.0, 2.0, 3.0])


def test_the_correspondence_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm(tmp_path)
    assert main(["robot", str(tmp_path / "arm.toml")]) == 0
    printed = capsys.readouterr().out
    assert "Frames of the maker's table" in printed
    assert " 2 joint 2       -400          0          0       -35  x" in printed
    assert main(["robot", "tx40"]) == 0
    assert "Frames of" not in capsys.readouterr().out
    assert main(["robot", "tx40", "--tip", "hand"]) == 2
    assert "--tip is for a URDF, and tx40 is not one" in capsys.readouterr().err
