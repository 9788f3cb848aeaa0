"""The vector of unknowns, and the model whose unknowns they are."""

from __future__ import annotations

import numpy as np
import pytest

import didim
from didim.errors import FitError
from didim.log.recording import Recording
from didim.robot.payload import Payload
from didim.terms.build import model_of
from didim.terms.model import Model
from didim.terms.unknown import Unknown, Unknowns

ROBOT = didim.load_robot("tx40")
THREE = Unknowns(tuple(Unknown(name=name, unit="kg") for name in "ABC"))


def two_recordings() -> list[Recording]:
    t, q = np.arange(50) / 100.0, np.random.default_rng(0).standard_normal((50, 6))
    plain = Recording(name="free", rate_hz=100.0, t=t, q=q, tau=q)
    return [plain, Recording(name="loaded", rate_hz=100.0, t=t, q=q, tau=q, payload="disc", own=("offsets",))]


def test_values_of_the_estimated_ones_stand_among_all() -> None:
    some = THREE.with_roles({"A": ("fixed", 2.5), "C": ("dropped", 0.0)})
    assert (some.names, some.estimated) == (("A", "B", "C"), [1])
    assert some.roles == ("fixed", "estimated", "dropped")
    np.testing.assert_array_equal(some.expand(np.array([7.0])), [2.5, 7.0, 0.0])
    np.testing.assert_array_equal(some.among_all(np.array([[1.0], [2.0]])), [[0, 1, 0], [0, 2, 0]])
    np.testing.assert_array_equal(some.expand_covariance(np.array([[4.0]])), np.diag([0.0, 4.0, 0.0]))
    assert (some.given("fixed"), some.given("dropped")) == ({"A": 2.5}, {"C": 0.0})


def test_the_unknowns_of_logs_follow_those_of_the_robot() -> None:
    model = model_of(ROBOT, two_recordings(), {"disc": Payload(name="disc", mass_kg=2.0)})
    b = len(ROBOT.base_parameters.names)
    assert model.unknowns.names[:b] == ROBOT.base_parameters.names
    assert model.unknowns.names[b:] == (
        *(f"disc.{name}" for name in ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ")),
        *(f"loaded.Off{joint}" for joint in range(1, 7)),
    )
    assert {entry.unit for entry in model.unknowns.entries[-6:]} == {"N.m"}
    assert model.has_known


def test_shares_act_in_their_own_recordings_alone() -> None:
    model = model_of(ROBOT, two_recordings(), {"disc": Payload(name="disc", mass_kg=2.0)})
    x = model.extended(ROBOT.parameter_set("didim"), {"loaded.Off2": 1.5})
    free, loaded = model.standard(x, 0), model.standard(x, 1)
    np.testing.assert_array_equal(free, ROBOT.parameter_set("didim"))
    change = dict(zip(ROBOT.parameter_names, loaded - free, strict=True))
    assert change["Off2"] == pytest.approx(1.5)
    assert change["M6"] == pytest.approx(2.0)
    b = len(ROBOT.base_parameters.names)
    np.testing.assert_array_equal(model.directions(0)[:, b:], 0.0)
    fixed = model.shares[0].fixed
    assert fixed is not None
    np.testing.assert_allclose(
        model.directions(1) @ model.project(x) + ROBOT.base_parameters.matrix @ fixed,
        ROBOT.base_parameters.project(loaded),
        atol=1e-12,
    )


def test_a_model_keeps_roles_and_shares_with_other_friction() -> None:
    model = model_of(ROBOT, two_recordings(), {"disc": Payload(name="disc")}).choosing({"Fv1": 8.0}, ["Off6"])
    other = model.with_robot(ROBOT.with_terms([didim.FrictionTerm(law="root", joint=0)]))
    added = set(other.own.parameter_names) - set(ROBOT.parameter_names)
    assert len(added) == 1
    assert other.unknowns.given("fixed") == {"Fv1": 8.0}
    assert other.unknowns.given("dropped") == {"Off6": 0.0}
    share = other.shares[0]
    (place,) = (other.own.parameter_names.index(name) for name in added)
    np.testing.assert_array_equal(share.directions[place], 0.0)
    np.testing.assert_array_equal(np.delete(share.directions, place, axis=0), model.shares[0].directions)


def test_roles_are_those_of_base_parameters() -> None:
    with pytest.raises(FitError, match="Fv1 is both fixed and dropped"):
        Model(ROBOT).choosing({"Fv1": 1.0}, ["Fv1"])
    with pytest.raises(FitError, match="M6"):
        Model(ROBOT).choosing({"M6": 1.0})
