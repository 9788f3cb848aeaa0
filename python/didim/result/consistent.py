"""The physically consistent robot nearest to a result: every standard parameter with interval and source.

Tested in ``tests/test_consistent.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from .._tools.arrays import Array
from .._tools.saved import restored, rows
from .._tools.words import columned
from ..errors import FitError, RobotError
from ..regression.consistent.bounds import Bounds
from ..regression.consistent.nearest import NEAREST_DRAWS, NearestRobot, Nearness, nearest_robot
from ..regression.consistent.prior import GAMMA, Prior
from ..robot.friction import Friction
from ..robot.robot import Geometry, JointLimits, Robot
from ..terms.model import Model
from ..terms.unknown import Role
from .finding import Finding
from .uncertainty import Uncertainty
from .verdict import Use

LARGE = 1.0
"""Half the squared distance per estimated parameter beyond which noise does not explain a physically inconsistent estimate."""


def recorded_robot(name: str, settings: Mapping[str, Any]) -> Robot:
    """Return the robot of a result from its recorded geometry and friction, without limits and parameter sets.

    Raises
    ------
    FitError
        For a result without them.
    """
    try:
        geometry = restored(Geometry, settings["robot"]["geometry"])
        friction = restored(Friction, settings["robot"]["friction"])
    except (AttributeError, KeyError, OverflowError, RobotError, TypeError, ValueError) as reason:
        raise FitError(f"the result does not hold its robot ({reason}): give robot=") from None
    return Robot(
        name=name,
        description="",
        path=Path(f"{name}.toml"),
        digest="",
        geometry=geometry,
        friction=friction,
        limits=(JointLimits(),) * geometry.n_driven,
        reduction=None,
        gains=None,
    )


def distance_sentence(half_distance: float, n_parameters: int) -> str:
    """Return the sentence on the distance of the nearest robot from the estimate."""
    far = half_distance > LARGE * n_parameters
    meaning = (
        "more than noise explains: the model, the log or the covariance is wrong"
        if far
        else "within the noise"
    )
    return f"the estimate is half a squared distance of {half_distance:.4g} from the nearest robot: {meaning}"


def distance_findings(half_distance: float, n_parameters: int) -> list[Finding]:
    """Return a finding if the nearest robot is further from the estimate than noise explains."""
    if half_distance <= LARGE * n_parameters:
        return []
    sentence = distance_sentence(half_distance, n_parameters)
    return [Finding(code="no-robot", grade="doubtful", value=half_distance, facts={"text": sentence})]


def record_of(robot: Robot, nearest: NearestRobot, gamma: float) -> dict[str, Any]:
    """Return the record for a result's JSON."""
    return {
        "gamma": gamma,
        "prior": nearest.prior,
        "half_distance": nearest.half_distance,
        "draws": len(nearest.draws),
        "parameters": rows(
            name=robot.parameter_names,
            unit=robot.parameter_units,
            value=nearest.x,
            std=nearest.std,
            low=nearest.low,
            high=nearest.high,
            source=["identified" if identified else "prior" for identified in nearest.identified],
        ),
    }


def table_of(record: Mapping[str, Any]) -> list[str]:
    """Return the lines of the table of standard parameters, intervals and sources."""
    entries = record["parameters"]
    cells = [("standard", "unit", "value", "95 % low", "95 % high")]
    cells += [
        (entry["name"], entry["unit"], *(f"{entry[key]:.4g}" for key in ("value", "low", "high")))
        for entry in entries
    ]
    sources = [
        "",
        *("identified" if entry["source"] == "identified" else "from the prior" for entry in entries),
    ]
    return [f"{line}  {source}".rstrip() for line, source in zip(columned(cells, 2), sources, strict=True)]


def base_covariance(covariance: Array, estimated: Sequence[int], draws: Array) -> Array:
    """Return the covariance of the draws for the estimated base parameters, zero elsewhere."""
    full = np.zeros_like(covariance)
    full[np.ix_(estimated, estimated)] = draws[np.ix_(estimated, estimated)]
    return full


class MovedToRobot:
    """Methods of a result for the nearest robot."""

    robot: str
    roles: tuple[Role, ...]
    beta: Array
    covariance: Array
    parameter_names: tuple[str, ...]
    settings: Mapping[str, Any]
    remarks: tuple[str, ...]
    uncertainty: Uncertainty | None
    evidence: tuple[Finding, ...]
    uses: tuple[Use, ...]

    def consistent(
        self,
        prior: str | Mapping[str, float] | Array | Prior = "generic",
        *,
        gamma: float = GAMMA,
        bounds: Bounds | None = None,
        draws: int = NEAREST_DRAWS,
        seed: int = 0,
        robot: Robot | None = None,
    ) -> Self:
        """Return the nearest robot: all standard parameters physically consistent, with intervals from draws.

        Each standard parameter is marked *identified*, or *from the prior* if the log does not identify it, or if another prior
        would shift it by more than 0.3 standard deviations. ``settings["consistent"]`` records the table; the torque errors
        remain those of the estimate. Payloads, drive gains and own offsets do not change.

        Parameters
        ----------
        prior : str, mapping, array or Prior
            "generic" for solids of the arm's size, a parameter set of `robot` such as "urdf", or values by name, such as from CAD.
        gamma : float
            Weight of the prior (nats): 1 is one nat per e-fold of volume.
        bounds : Bounds, optional
            Bounds on masses and centres of mass.
        draws, seed : int
            Number of draws of the estimate from its covariance, and the seed of NumPy's generator.
        robot : Robot, optional
            The robot with the parameter set `prior`; by default that of the result.

        Raises
        ------
        FitError
            For a result without standard deviations, a parameter set without `robot`, and when no robot meets all conditions.

        Notes
        -----
        ``test_consistent.py`` compares with Clarabel, and checks intervals on simulated logs.
        """
        settings = Nearness(prior=prior, gamma=gamma, bounds=bounds, draws=draws, seed=seed)
        known, model, nearest = self._nearest(settings, robot)
        # With physical parameters, simulation has the grade of the torque prediction.
        control = next((use for use in self.uses if use.name == "control" and use.fit_for), None)
        moved: Self = replace(
            self,  # type: ignore[type-var]
            beta=known.base_parameters.project(nearest.x),
            covariance=base_covariance(self.covariance, model.unknowns.estimated, nearest.covariance),
            parameters=nearest.x,
            warnings=(),
            evidence=(
                *(reason for reason in self.evidence if reason.code != "not-physical"),
                *distance_findings(nearest.half_distance, len(model.unknowns.estimated)),
            ),
            uses=tuple(
                replace(control, name=use.name) if use.name == "simulation" and control is not None else use
                for use in self.uses
            ),
            remarks=(*self.remarks, distance_sentence(nearest.half_distance, len(model.unknowns.estimated))),
            uncertainty=None if self.uncertainty is None else self.uncertainty.of_draws(),
            settings={**self.settings, "consistent": record_of(known, nearest, gamma)},
        )
        return moved

    def _nearest(self, settings: Nearness, robot: Robot | None) -> tuple[Robot, Model, NearestRobot]:
        """Return the robot of the result, or the one given, its model, and the robot nearest to the estimate."""
        if robot is None and isinstance(settings.prior, str) and settings.prior != "generic":
            raise FitError(
                f"a result keeps no parameter sets of its robot: prior={settings.prior!r} needs the robot as well, "
                "robot=didim.load_robot(...)"
            )
        known = recorded_robot(self.robot, self.settings) if robot is None else robot
        if known.parameter_names != self.parameter_names:
            raise FitError(f"the result is for robot {self.robot!r}, and the robot is {known.name!r}")
        values = np.where([role == "fixed" for role in self.roles], self.beta, 0.0)
        roles = zip(self.roles, values, strict=True)
        model = Model(known, roles=dict(zip(known.base_parameters.names, roles, strict=True)))
        freedom = np.inf if self.uncertainty is None else self.uncertainty.degrees_of_freedom
        return known, model, nearest_robot(model, self.beta, self.covariance, settings, freedom)
