"""Robots for the tests: random ones, and their twins in Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from didim.robot.friction import Friction, FrictionTerm, Law
from didim.robot.robot import Geometry, JointLimits, Robot

Array = NDArray[np.float64]


def make_robot(geometry: Geometry, **friction: Any) -> Robot:
    """Build a robot without a file."""
    n = len(geometry.kinds)
    options: dict[str, Any] = {
        "model": "symmetric",
        "coulomb": "sign",
        "coupling": "shaft",
        "smoothing": (0.0,) * n,
        "dead_zone": (0.0,) * n,
    }
    return Robot(
        name="test",
        description="",
        path=Path("test.toml"),
        digest="",
        geometry=geometry,
        friction=Friction(**(options | friction)),
        limits=(JointLimits(),) * n,
        reduction=None,
        gains=None,
    )


# Right angles, and angles that are clearly none: in between, what is dependent is a matter of tolerance.
angles = st.one_of(
    st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi]),
    st.floats(-3.0, 3.0).filter(lambda angle: abs(np.sin(2.0 * angle)) > 0.05),
)
# Likewise: a gravity of 1e-9 m/s^2 tells mass and rotor apart, or not.
gravities = st.floats(-10.0, 10.0).filter(lambda g: g == 0.0 or abs(g) > 0.01)
# Every second one along an axis, so that slides of right angles are along it.
directions = st.one_of(
    st.tuples(*[gravities] * 3),
    st.sampled_from([(0.0, 0.0, -9.81), (0.0, -9.81, 0.0), (9.81, 0.0, 0.0)]),
)
lengths = st.one_of(st.just(0.0), st.floats(0.01, 1.0))


SLOW = 0.3
"""Velocity of the laws that have one (rad/s or m/s), and displacement of memory (rad or m)."""


@st.composite
def robots(
    draw: st.DrawFn,
    largest: int = 9,
    coupled: bool = True,
    *,
    smallest: int = 1,
    terms: bool = False,
    shapes: tuple[str, ...] = (),
) -> Robot:
    """Serial robots of joints of both kinds, or of `shapes` as "PRR", with any friction model, and any `terms`."""
    n = draw(st.integers(smallest, largest))
    kinds = tuple(draw(st.sampled_from(["revolute", "prismatic"])) for _ in range(n))
    if shapes:
        kinds = tuple("prismatic" if kind == "P" else "revolute" for kind in draw(st.sampled_from(shapes)))
        n = len(kinds)
    rows = [tuple(draw(s) for s in (angles, lengths, angles, lengths)) for _ in range(n)]
    coupling = np.eye(n)
    if coupled and n > 1 and draw(st.booleans()):
        motor = draw(st.integers(1, n - 1))
        coupling[motor, draw(st.integers(0, motor - 1))] = draw(st.sampled_from([1.0, -1.0, 0.5]))
    alpha, d, theta, r = (tuple(column) for column in zip(*rows, strict=True))
    geometry = Geometry(
        kinds=kinds,
        alpha=alpha,
        d=d,
        theta=theta,
        r=r,
        gravity=draw(directions),
        coupling=tuple(tuple(row) for row in coupling.tolist()),
    )
    coulomb = draw(st.sampled_from(["sign", "tanh"]))
    model = draw(st.sampled_from(["symmetric", "asymmetric"]))
    zone = draw(st.sampled_from([0.0, 0.001, 0.01, 0.1]))
    laws: list[Law] = ["atan", "stribeck", "root", "load", "hold", "dahl"]
    laws += ["forward"] if model == "symmetric" else []
    laws += ["rest"] if zone > 0.0 else []
    chosen = [draw(st.sets(st.sampled_from(laws), max_size=3)) if terms else set() for _ in range(n)]
    return make_robot(
        geometry,
        model=model,
        coulomb=coulomb,
        coupling=draw(st.sampled_from(["shaft", "printed"])),
        smoothing=(draw(st.sampled_from([0.002, 0.05])),) * n if coulomb == "tanh" else (0.0,) * n,
        dead_zone=(zone,) * n,
        terms=tuple(
            FrictionTerm(law=law, joint=joint, velocity=SLOW if law in ("atan", "stribeck", "dahl") else 0.0)
            for joint, own in enumerate(chosen)
            for law in sorted(own)
        ),
    )


@dataclass(frozen=True)
class Motion:
    """Random positions, velocities and accelerations."""

    q: Array
    dq: Array
    ddq: Array


def random_motion(rng: np.random.Generator, samples: int, n_dof: int) -> Motion:
    """Return states within a turn and a few units per second."""
    shape = (samples, n_dof)
    return Motion(rng.uniform(-3, 3, shape), rng.uniform(-2, 2, shape), rng.uniform(-5, 5, shape))


def changed(robot: Robot, kind: str = "mjcf") -> Array:
    """Return the parameters of a robot's file with other bodies and drives; massless links stay so."""
    rng = np.random.default_rng(0)
    x = robot.parameter_set(kind).copy()
    for j in range(robot.n_joints):
        first = robot.parameter_names.index(f"XX{j + 1}")
        x[first : first + 10] *= rng.uniform(1.1, 1.6)
        for key in ("Ia", "Fv", "Fc"):
            x[robot.parameter_names.index(f"{key}{j + 1}")] += rng.uniform(0.1, 0.5)
    return x


def slow_motion(rng: np.random.Generator, samples: int, robot: Robot) -> Motion:
    """Return such states of which each joint has a third where its friction turns: half of these are inside its dead zone."""
    motion = random_motion(rng, samples, robot.n_dof)
    friction = robot.friction
    for pace in (friction.dead_zone, friction.smoothing):
        slow = rng.random(motion.dq.shape) < 1.0 / 3.0
        motion.dq[slow & (np.array(pace) > 0.0)] *= max(pace)
    # A sign that is kept has none before the first motion.
    motion.dq[0] = 1.0
    return motion


def random_parameters(rng: np.random.Generator, robot: Robot, *, drive: bool = True) -> Array:
    """Return standard parameters of real bodies; without rotors and friction when `drive` is False."""
    x = rng.uniform(0.1, 1.0, len(robot.parameter_names))
    if not drive:
        x[[name.startswith(("Ia", "F", "Off")) for name in robot.parameter_names]] = 0.0
    for joint in range(robot.n_dof):
        first = robot.parameter_names.index(f"XX{joint + 1}")
        # Three point masses or more have an inertia that obeys the triangle inequalities.
        mass = rng.uniform(0.2, 1.0, 4)
        place = rng.uniform(-0.5, 0.5, (4, 3))
        squares = np.einsum("k,ki,kj->ij", mass, place, place)
        inertia = np.trace(squares) * np.eye(3) - squares
        x[first : first + 6] = inertia[np.triu_indices(3)]
        x[first + 6 : first + 9] = mass @ place
        x[first + 9] = mass.sum()
    return x


def relative(error: Array, reference: Array) -> float:
    """Return the largest error, relative to the largest reference value."""
    return float(np.abs(error).max() / max(1.0, float(np.abs(reference).max())))
