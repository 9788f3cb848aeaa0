"""The integrator that takes steep friction implicitly: with defaults, at reversals, in methods, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import didim
from didim.errors import SimulationError
from didim.experiment.loop import closed_loop
from didim.loop.closed_loop import ClosedLoop
from didim.methods.didim.simulability import chosen_steps
from didim.studies.simulated_log import packaged_experiment, simulated_log

REFERENCE = didim.Reference.point_to_point(
    [[0.0, 0.0], [0.4, -0.3], [0.1, 0.2]],
    max_velocity=[2.0, 3.0],
    max_acceleration=[8.0, 12.0],
    dwell_s=0.05,
)
CONTROLLER = didim.Controller.tuned([8.0, 12.0], 0.7, inertia=[1.5, 0.2])


def planar(smoothing: float) -> tuple[didim.Robot, np.ndarray]:
    robot = didim.load_robot("planar2").with_smoothing([smoothing] * 2)
    return robot, robot.sets["reference"]


def test_defaults_take_fewer_steps_and_come_nearer() -> None:
    loop = closed_loop(packaged_experiment("tx40"))
    x = np.array(loop.robot.sets["didim_physical"])

    def one(integrator: str) -> ClosedLoop:
        return ClosedLoop.of(
            loop.robot, loop.reference, loop.controller, duration_s=2.0, rate_hz=200, integrator=integrator
        )

    def positions(loop: ClosedLoop) -> np.ndarray:
        (q, *_), outcomes = loop.run(x[None])
        assert outcomes[0].completed
        return np.asarray(q[0])

    exact = positions(one("rk4").even(2e-5))
    implicit, classical = one("imex"), one("rk4")
    assert implicit.schedule.steps < 0.5 * classical.schedule.steps
    errors = [float(np.abs(positions(one) - exact).max()) for one in (implicit, classical)]
    assert errors[0] < 0.1 * errors[1], errors


@pytest.mark.parametrize("backwards", [None, 0.1])
def test_a_strong_gear_on_a_light_link_is_simulated_in_steps_beyond_its_time_constant(
    backwards: float | None,
) -> None:
    """Viscous friction stops the second joint in 0.1 ms, forwards or both ways: explicit steps of 1 ms leave any bounds."""
    robot, _ = planar(1e-3)
    light = {"ZZ1": 0.02, "M1": 1.0, "Ia1": 0.01, "Fv1": 0.5, "Fc1": 0.1, "Ia2": 1e-4, "Fv2": 1.0, "Fc2": 0.2}
    if backwards is not None:
        robot = robot.with_friction(model="asymmetric")
        light |= {f"{name}{end}": light[name] for name in ("Fv1", "Fc1", "Fv2", "Fc2") for end in "+-"}
        light["Fv2-"] = backwards
    x = np.array([light.get(name, 0.0) for name in robot.parameter_names])
    t = np.arange(101) / 200.0
    commands = np.stack([0.2 * np.sin(4.0 * np.pi * t), 0.3 * np.sin(6.0 * np.pi * t)], axis=1)
    reference = didim.Reference.sampled(commands, rate_hz=200)
    controller = didim.Controller.pd([18.0, 18.0], [0.0, 0.0])

    def run(step: float, integrator: str) -> didim.Simulation:
        return didim.simulate(
            robot,
            x,
            reference,
            controller,
            integrator=integrator,
            step=step,
            fine_step=step,
            rate_hz=200,
            duration_s=0.5,
            divergence=10.0,
            check=False,
        )

    exact = run(1e-5, "rk4").q
    assert not run(1e-3, "rk4").outcome.completed
    # Where friction differs by direction a reversal is met to a step.
    for step, most in ((1e-3, 1e-3), (5e-4, 2e-4 if backwards is None else 1e-3)):
        off = np.abs(run(step, "imex").q - exact).max(axis=0)
        assert (off < most).all(), off


def test_the_estimate_of_the_error_is_that_of_third_order() -> None:
    robot, x = planar(0.05)
    run = didim.simulate(
        robot, x, REFERENCE, CONTROLLER, integrator="imex", step=5e-4, rate_hz=200, duration_s=0.4
    )
    exact = didim.simulate(
        robot, x, REFERENCE, CONTROLLER, step=1e-5, fine_step=1e-5, rate_hz=200, duration_s=0.4, check=False
    )
    assert run.error is not None
    found = np.abs(run.q - exact.q).max(axis=0)
    assert np.all(found < 2.0 * run.error.q)
    assert np.all(found > 0.5 * run.error.q)


def test_didim_finds_the_same_estimate() -> None:
    experiment = packaged_experiment("tx40")
    short = replace(experiment, simulation=replace(experiment.simulation, duration_s=3.0))
    log = simulated_log(short, short.robot.parameter_set("didim"))
    usual = didim.identify(log, didim.DIDIM())
    asked = replace(log.simulation, integrator="imex", step_s=5e-4, fine_step_s=None)
    other = didim.identify(replace(log, simulation=asked), didim.DIDIM())
    assert usual.converged
    assert other.converged
    assert np.abs(other.beta - usual.beta).max() > 0.0
    assert np.all(np.abs(other.beta - usual.beta) < 0.1 * usual.std)


def test_what_it_does_not_take_is_refused() -> None:
    robot, _ = planar(0.01)
    rigid = didim.load_robot("planar2")
    with pytest.raises(SimulationError, match="'rk4' or 'imex', got 'euler'"):
        ClosedLoop.of(robot, REFERENCE, CONTROLLER, integrator="euler")
    with pytest.raises(SimulationError, match="takes friction as tanh at every joint"):
        ClosedLoop.of(rigid, REFERENCE, CONTROLLER, integrator="imex")
    zone = replace(robot, friction=replace(robot.friction, dead_zone=(0.01, 0.0)))
    with pytest.raises(SimulationError, match="no dead zone"):
        ClosedLoop.of(zone, REFERENCE, CONTROLLER, integrator="imex")
    arm = didim.load_robot("tx40").with_smoothing([0.01] * 6)
    printed = replace(arm, friction=replace(arm.friction, coupling="printed"))
    experiment = packaged_experiment("tx40")
    loop = closed_loop(experiment)
    with pytest.raises(SimulationError, match="speed of their shafts alone"):
        ClosedLoop.of(printed, loop.reference, loop.controller, integrator="imex")


def test_friction_asks_consistent_didim_for_no_step() -> None:
    settings = packaged_experiment("tx40").simulation
    fast = np.full(6, 1e5)
    coarse, fine = chosen_steps(500.0, fast, replace(settings, step_s=None, fine_step_s=None))
    assert max(fine) < 2e-5
    same, none = chosen_steps(
        500.0, fast, replace(settings, step_s=None, fine_step_s=None, integrator="imex")
    )
    assert same == coarse
    assert set(none) == {coarse}


@pytest.mark.parametrize("load", [0.5, 0.8])
@pytest.mark.parametrize("other", [0.0, 0.1])
def test_a_joint_that_friction_holds_does_not_creep(load: float, other: float) -> None:
    """A light joint under a share of its friction, which the other joint shakes.

    What holds it is no impulse on the other joint, whose own friction turns around at reversals.
    """
    robot, _ = planar(1e-4)
    inertias = {"ZZ1": 0.02, "ZZ2": 0.003, "M1": 1.0, "M2": 1.0, "Ia1": 0.01, "Ia2": 0.005}
    friction = {"Fc1": other, "Fv1": 0.5, "Fc2": 0.6, "Fv2": 0.8, "Off2": 0.6 * load}
    x = np.array([{**inertias, **friction}.get(name, 0.0) for name in robot.parameter_names])
    t = np.arange(401) / 200.0
    shaken = np.stack([0.2 * np.sin(4.0 * np.pi * t), np.zeros(401)], axis=1)
    reference = didim.Reference.sampled(shaken, rate_hz=200)
    controller = didim.Controller.pd([18.0, 18.0], [0.0, 0.0])

    def positions(step: float) -> np.ndarray:
        return didim.simulate(
            robot,
            x,
            reference,
            controller,
            integrator="imex",
            step=step,
            fine_step=step,
            rate_hz=200,
            duration_s=2.0,
            check=False,
        ).q

    exact = positions(1e-4)
    for step in (1e-3, 2e-3):
        off = np.abs(positions(step) - exact).max(axis=0)
        assert (off < [1.5e-4 if other else 2e-6, 2e-5]).all(), off
