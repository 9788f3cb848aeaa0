"""Payloads as ten inertial parameters: what is known of them, and their way to the last link."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import didim
from didim.errors import ExperimentError
from didim.robot.payload import Payload, ends, last_link, payload_columns, read_flange
from didim.robot.rigid_body import body_pseudo_inertia, inverse, moved, pose, rotation_of, ten_parameters
from tables import experiment_table
from urdfs import legs, made

MASS, CENTRE = 2.5, (0.03, -0.02, 0.11)
INERTIA = (0.02, 0.001, -0.002, 0.025, 0.0005, 0.015)


def ten_of(mass: float, centre: tuple[float, ...], inertia: tuple[float, ...]) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = inertia
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return ten_parameters(body_pseudo_inertia(mass, matrix, pose(np.eye(3), centre)))


@pytest.mark.parametrize(
    ("known", "unknown"),
    [
        ({}, 10),
        ({"mass_kg": MASS}, 9),
        ({"com_m": CENTRE}, 7),
        ({"mass_kg": MASS, "com_m": CENTRE}, 6),
        ({"com_m": CENTRE, "inertia_kg_m2": INERTIA}, 1),
        ({"mass_kg": MASS, "com_m": CENTRE, "inertia_kg_m2": INERTIA}, 0),
    ],
)
def test_what_is_known_and_what_is_not_make_the_body(known: dict[str, object], unknown: int) -> None:
    payload = Payload(name="body", **known)  # type: ignore[arg-type]
    ten = ten_of(MASS, CENTRE, INERTIA)
    constant, columns, names = payload.split
    assert columns.shape == (10, unknown) == (10, len(names))
    assert payload.known == (unknown == 0)
    # The body is one of those that the unknown parameters describe.
    values = np.linalg.lstsq(columns, ten - constant, rcond=None)[0] if unknown else np.zeros(0)
    np.testing.assert_allclose(constant + columns @ values, ten, atol=1e-12)


@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6))
def test_a_payload_is_the_same_body_in_every_frame(numbers: list[float]) -> None:
    frame = pose(rotation_of(numbers[:3]), numbers[3:])
    ten = ten_of(MASS, CENTRE, INERTIA)
    there = moved(ten, frame)
    assert there[9] == pytest.approx(MASS)
    np.testing.assert_allclose(there[6:9] / MASS, frame[:3, :3] @ CENTRE + frame[:3, 3], atol=1e-12)
    np.testing.assert_allclose(moved(there, inverse(frame)), ten, atol=1e-9)


def test_a_payload_adds_to_the_last_link() -> None:
    robot = didim.load_robot("tx40")
    ten = ten_of(MASS, CENTRE, INERTIA)
    x = last_link(robot, np.eye(4)) @ ten
    at = robot.parameter_names.index
    assert x[at("M6")] == MASS
    assert x[at("XX6")] == ten[0]
    assert np.count_nonzero(x) == 10


def test_a_payload_may_be_on_any_link(tmp_path: Path) -> None:
    robot = made(tmp_path, legs(2, 3))
    ten, frame = ten_of(MASS, CENTRE, INERTIA), robot.own_frames[2]
    for link in ("leg0_2", "leg0_2_joint", "3"):
        x = payload_columns(robot, Payload(name="foot", link=link)) @ ten
        third = [k for k, parameter in enumerate(robot.standard_parameters) if parameter.joint == 2]
        np.testing.assert_allclose(x[third[:10]], moved(ten, frame), atol=1e-15)
        assert not np.delete(x, third[:10]).any()
    assert ends(robot) == [2, 5]
    with pytest.raises(ExperimentError, match="is a tree: give link, such as 'leg0_2', 'leg1_2'"):
        payload_columns(robot, Payload(name="foot"))
    with pytest.raises(ExperimentError, match="has no link 'leg0_3'; did you mean 'leg0_"):
        payload_columns(robot, Payload(name="foot", link="leg0_3"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mass_kg": 0.0}, "mass_kg must be a positive number"),
        ({"com_m": (0.0, 1.0)}, "com_m needs 3 finite numbers"),
        ({"inertia_kg_m2": INERTIA}, "needs the centre"),
        ({"com_m": CENTRE, "inertia_kg_m2": (1.0, 0.0, 0.0, 1.0, 0.0, 9.0)}, "is not that of a body"),
        ({"name": "none", "mass_kg": 1.0}, "empty flange"),
    ],
)
def test_wrong_payloads_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        Payload(**({"name": "body"} | options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mass_kg", 1e300),
        ("com_m", (1e300, 0.0, 0.0)),
        ("inertia_kg_m2", (1e300, 0.0, 0.0, 1e300, 0.0, 1e300)),
    ],
)
def test_payloads_whose_squares_are_infinite_are_refused(key: str, value: Any) -> None:
    known = {"com_m": CENTRE} | {key: value}
    with pytest.raises(ExperimentError, match=f"payload 'body': {key} must be at most 1e[+]09"):
        Payload(name="body", **known)


def test_a_flange_whose_squares_are_infinite_is_refused() -> None:
    table = experiment_table("flange", {"xyz_m": [0.0, -1e300, 0.0]}, "arm.toml")
    with pytest.raises(ExperimentError, match=r"^arm.toml: \[flange\] xyz_m must be at most 1e[+]09"):
        read_flange(table)
