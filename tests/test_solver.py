"""The seam of the regressions: any solver of (7) in any method, by name or as an object."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import simulated
from didim import DIDIM, IDIMLS, Status, identify
from didim.errors import FitError
from didim.experiment.experiment import Experiment
from didim.experiment.experiment_file import load_experiment
from didim.regression.fit import Fit, Progress
from didim.regression.least_squares import solve
from didim.regression.settings import LeastSquaresSettings
from didim.regression.solver import SOLVERS, solver_name
from didim.robot.robot import Robot
from didim.robot.robot_file import load_robot
from didim.studies.simulated_log import simulated_log
from didim.terms.rows import LinearSystem, by_joint, by_window, stacked
from didim.terms.unknown import Unknowns

pytestmark = pytest.mark.usefixtures("without_verdict")

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ridge:
    """Rows of a prior below the system."""

    share: float = 1e-3
    name: str = "ridge"

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        prior = self.share * np.linalg.norm(system.w, axis=0)
        w, y = np.vstack([system.w, np.diag(prior)]), np.append(system.y, np.zeros(prior.size))
        beta = np.linalg.lstsq(w, y, rcond=None)[0]
        plain = solve(system, settings)
        stopped = progress is not None and progress(1, beta, system.y - system.w @ beta)
        return replace(
            plain,
            solution=beta,
            residual=system.y - system.w @ beta,
            stopped=stopped,
            remarks=("a prior pulls all parameters towards zero",),
            record={"share": self.share},
        )


@dataclass(frozen=True)
class KnowsTheRobot:
    """A solver that is made for a robot and its estimated parameters."""

    def for_robot(self, robot: Robot, selection: Unknowns) -> KnownRobot:
        return KnownRobot(robot.n_dof, tuple(robot.base_parameters.names[k] for k in selection.estimated))


@dataclass(frozen=True)
class KnownRobot:
    n_dof: int
    names: tuple[str, ...]

    def __call__(
        self, system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        assert system.names == self.names
        assert len(system.joints) == self.n_dof
        return solve(system, settings, progress)


@pytest.fixture(scope="module")
def log() -> Experiment:
    robot = load_robot("planar2")
    return simulated.experiment(robot, simulated.log(robot, robot.parameter_set("reference"), noise=0.05))


def test_a_solver_by_name_and_as_a_function_is_the_default(log: Experiment) -> None:
    default = identify(log)
    for solver in ("least-squares", solve):
        fit = identify(log, IDIMLS(solver=solver))
        np.testing.assert_array_equal(fit.beta, default.beta)
        assert fit.settings["solver"] == {"name": "least-squares"}


def test_a_solver_of_ones_own(log: Experiment) -> None:
    plain, ridge = identify(log), identify(log, IDIMLS(solver=Ridge(0.1)))
    assert ridge.error_norm > 1.01 * plain.error_norm
    assert ridge.remarks[0] == "a prior pulls all parameters towards zero"
    assert ridge.settings["solver"] == {"name": "ridge", "share": 0.1}
    assert [item.iteration for item in ridge.history] == [1]
    stopped = identify(log, IDIMLS(solver=Ridge(0.1)), callback=lambda iteration: True)
    assert stopped.status is Status.STOPPED


def test_a_solver_that_does_not_converge_says_so(log: Experiment) -> None:
    def unfinished(
        system: LinearSystem, settings: LeastSquaresSettings, progress: Progress | None = None
    ) -> Fit:
        return replace(solve(system, settings), converged=False)

    fit = identify(log, IDIMLS(solver=unfinished))
    assert fit.status is Status.NOT_CONVERGED
    # It reported no solution to the callback: the result still has its one entry.
    assert [item.iteration for item in fit.history] == [1]


def test_a_solver_that_must_know_the_robot(log: Experiment) -> None:
    name = load_robot("planar2").base_parameters.names[0]
    fit = identify(log, IDIMLS(solver=KnowsTheRobot(), fixed={name: 1.0}))
    np.testing.assert_array_equal(fit.beta, identify(log, IDIMLS(fixed={name: 1.0})).beta)


def test_didim_takes_the_same_solvers(project: Path) -> None:
    experiment = load_experiment(project / "examples" / "planar2_simulation.toml")
    exact = simulated_log(experiment, experiment.robot.parameter_set("reference"), noise=False, refinement=1)
    plain = identify(exact, DIDIM(physical=False))
    np.testing.assert_array_equal(identify(exact, DIDIM(solver=KnowsTheRobot())).beta, plain.beta)
    ridge = identify(exact, DIDIM(solver=Ridge(1e-3)))
    assert ridge.settings["solver"]["name"] == "ridge"
    assert 0.0 < np.linalg.norm(ridge.beta - plain.beta) < 0.1 * np.linalg.norm(plain.beta)


@pytest.mark.parametrize("method", [IDIMLS, DIDIM])
def test_methods_with_solvers_are_pickled_and_compared(method: type[IDIMLS] | type[DIDIM]) -> None:
    for solver in ("least-squares", solve, Ridge(0.2), KnowsTheRobot()):
        made = method(solver=solver)
        assert pickle.loads(pickle.dumps(made)) == made
    assert method(solver=Ridge(0.2)) != method(solver=Ridge(0.3))


@pytest.mark.parametrize(
    ("solver", "message"),
    [
        ("least-square", "there is no solver 'least-square'; did you mean 'least-squares'?"),
        (3, "solver must be a name or a function of a system and settings, got 3"),
        (Ridge, "solver must be a name or a function of a system and settings, got <class"),
    ],
)
def test_wrong_solvers(solver: object, message: str) -> None:
    with pytest.raises(FitError, match=message):
        IDIMLS(solver=solver)  # type: ignore[arg-type]


def test_every_named_solver_can_be_loaded(log: Experiment) -> None:
    for name in SOLVERS:
        assert IDIMLS(solver=name).job(log).solver is not None
        assert solver_name(name) == name


def test_blocks_of_a_system_and_parts_of_it(log: Experiment) -> None:
    windows = replace(log.recordings[0], windows=((0, 1000), (1500, 2500)), name="second")
    two = replace(log, recordings=(log.recordings[0], windows))
    job = IDIMLS().job(two)
    system = job.system(job.parts("fit"))
    n = job.robot.n_dof
    assert [len(blocks) for blocks in by_joint(system.blocks)] == [3] * n
    assert [(blocks[0].recording, blocks[0].window) for blocks in by_window(system.blocks)] == [
        (0, 0),
        (1, 0),
        (1, 1),
    ]
    rows = np.concatenate([np.arange(system.y.size)[block.rows] for block in system.blocks])
    np.testing.assert_array_equal(rows, np.arange(system.y.size))
    # All windows but the first are the system of the second recording.
    rest = [block for block in system.blocks if block.recording == 1]
    alone = IDIMLS().job(replace(log, recordings=(windows,)))
    expected = alone.system(alone.parts("fit"))
    part = system.part(rest)
    np.testing.assert_array_equal(part.w, expected.w)
    np.testing.assert_array_equal(part.y, expected.y)
    assert [block.rows for block in part.blocks] == [block.rows for block in expected.blocks]
    np.testing.assert_array_equal(solve(part, job.settings).solution, solve(expected, job.settings).solution)


def test_blocks_know_rate_and_correlation(log: Experiment) -> None:
    decimated = replace(log, signal=replace(log.signal, decimation=(5, 2)))
    job = IDIMLS().job(decimated)
    for block in job.system(job.parts("fit")).blocks:
        assert block.rate_hz == log.recordings[0].rate_hz / 10.0
        assert block.correlation is not None
        assert block.correlation[0] == 1.0
    assert all(block.correlation is None for block in stacked(2, [3, 4]))
    assert [block.n_rows for block in stacked(2, [3, 4])] == [3, 4, 3, 4]
