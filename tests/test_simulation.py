"""The closed loop: order, energy, power, a pendulum, lanes and threads, the TX40 of Table II, endings and wrong calls."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson
from scipy.special import ellipj, ellipk

import didim
from didim.errors import ShapeError, SimulationError
from didim.loop.closed_loop import ClosedLoop
from didim.loop.controller import Controller, Digital
from didim.loop.outcome import Outcome, SimulationStatus
from didim.loop.reference import Reference
from didim.loop.simulation import Simulation, StepWarning
from didim.loop.tuning import mean_inertia
from didim.robot.robot import Geometry, Robot
from robots import make_robot

Array = NDArray[np.float64]


def potential_energy(robot: Robot, q: Array, x: Array) -> Array:
    """Minus gravity times mass times height, by forward kinematics written down here."""
    geometry = robot.geometry
    names = robot.parameter_names
    found = np.zeros(len(q))
    for k, positions in enumerate(q):
        rotation, origin = np.eye(3), np.zeros(3)
        for j, kind in enumerate(geometry.kinds):
            turning = kind == "revolute"
            theta = geometry.theta[j] + positions[j] * turning
            r = geometry.r[j] + positions[j] * (not turning)
            (ca, sa), (ct, st) = ((math.cos(a), math.sin(a)) for a in (geometry.alpha[j], theta))
            origin = origin + rotation @ [geometry.d[j], -sa * r, ca * r]
            rotation = rotation @ np.array([[ct, -st, 0.0], [ca * st, ca * ct, -sa], [sa * st, sa * ct, ca]])
            mx, my, mz, m = (x[names.index(f"{name}{j + 1}")] for name in ("MX", "MY", "MZ", "M"))
            found[k] -= np.dot(geometry.gravity, m * origin + rotation @ [mx, my, mz])
    return found


def energy(robot: Robot, run: Simulation, x: Array) -> Array:
    """Kinetic and potential energy at the records (J)."""
    M = didim.inertia_matrix(robot, run.q, x)
    kinetic = 0.5 * np.einsum("ki,kij,kj->k", run.dq, M, run.dq)
    return np.asarray(kinetic + potential_energy(robot, run.q, x))


def without_friction(robot: Robot, x: Array) -> Array:
    x = np.array(x)
    x[[name.startswith(("Fv", "Fc", "Off")) for name in robot.parameter_names]] = 0.0
    return x


def still(n: int, seconds: float) -> Reference:
    return Reference.sampled(np.zeros((5, n)), rate_hz=4.0 / seconds)


def free(robot: Robot, x: Array, q: Array, dq: Array, seconds: float, step: float, rate: float) -> Simulation:
    """Fall without a controller."""
    return didim.simulate(
        robot,
        x,
        still(robot.n_dof, seconds),
        Controller.pd(np.zeros(robot.n_dof), np.zeros(robot.n_dof)),
        start=(q, dq),
        step=step,
        fine_step=step,
        rate_hz=rate,
        check=False,
    )


def planar() -> tuple[Robot, Array, Reference, Controller]:
    """A small problem: smooth friction, a smooth reference and a PD."""
    robot = didim.load_robot("planar2").with_smoothing([0.5, 0.5])
    reference = Reference.fourier(
        [[0.5, 0.3], [0.2, -0.2]], [[0.1, 0.2], [-0.1, 0.1]], period_s=1.0, offset=[0.3, -0.5]
    )
    return robot, robot.sets["reference"], reference, Controller.pd([200.0, 80.0], [20.0, 6.0])


TX40_LIMITS: dict[str, Any] = {
    "max_position": [2.6, 1.8, 2.0, 3.5, 1.9, 4.0],
    "max_velocity": [4.5, 4.5, 6.5, 6.5, 5.0, 10.0],
    "max_acceleration": [25.0, 25.0, 35.0, 60.0, 60.0, 90.0],
}


def tx40(smoothing: float = 0.01) -> tuple[Robot, Array, Reference, Controller]:
    """Return the TX40 of Table II, corrected, on the rich reference of 20 harmonics, with a PD of 20 to 50 Hz."""
    robot = didim.load_robot("tx40").with_smoothing([smoothing] * 6)
    x = robot.sets["didim"]
    reference = Reference.random_fourier(harmonics=20, period_s=10.0, seed=1, **TX40_LIMITS)
    inertia = mean_inertia(robot, x, reference)
    return robot, x, reference, Controller.tuned([20.0, 20.0, 25.0, 35.0, 35.0, 50.0], 0.7, inertia)


def ratios(errors: list[float]) -> Array:
    return np.divide(errors[:-1], errors[1:])


# --- Order four ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("problem", "coarsest"), [(planar, 1.6e-3), (lambda: tx40(0.5), 8e-4)], ids=["planar2", "tx40"]
)
def test_the_error_falls_sixteen_times_per_halved_step(problem: Callable[[], Any], coarsest: float) -> None:
    robot, x, reference, controller = problem()

    def at(step: float) -> Array:
        run = didim.simulate(
            robot,
            x,
            reference,
            controller,
            step=step,
            fine_step=step,
            rate_hz=10.0,
            duration_s=1.0,
            check=False,
        )
        return np.concatenate([run.q, run.dq])

    exact = at(coarsest / 32.0)
    errors = [float(np.abs(at(coarsest / parts) - exact).max()) for parts in (1.0, 2.0, 4.0)]
    assert np.all((ratios(errors) > 14.0) & (ratios(errors) < 20.0)), errors


def test_a_pendulum_is_its_elliptic_function() -> None:
    """``sin(a / 2) = k cd(w t | k^2)`` from rest at ``a0``, with ``k = sin(a0 / 2)`` and ``w^2 = g MX / ZZ``."""
    row = (0.0,)
    level = Geometry(
        kinds=("revolute",), alpha=row, d=row, theta=row, r=row, gravity=(0.0, -9.81, 0.0), coupling=((1.0,),)
    )
    robot = make_robot(level)
    x = np.zeros(14)
    x[robot.parameter_names.index("ZZ1")], x[robot.parameter_names.index("MX1")] = 0.25, 0.75
    a0, w = 2.9, math.sqrt(9.81 * 0.75 / 0.25)
    k = math.sin(a0 / 2.0)
    period = 4.0 * ellipk(k**2) / w
    # q is measured from the level, a from where it hangs.
    start = np.array([a0 - math.pi / 2.0])

    def error(step: float) -> float:
        run = free(robot, x, start, np.zeros(1), 3.0, step, 40.0)
        assert run.t[-1] > 1.1 * period
        _, cn, dn, _ = ellipj(w * run.t, k**2)
        swing = 2.0 * np.arcsin(k * cn / dn)
        return float(np.abs(run.q[:, 0] + math.pi / 2.0 - swing).max())

    errors = [error(step) for step in (1e-2, 5e-3, 2.5e-3, 1e-3)]
    assert np.all((ratios(errors[:3]) > 14.0) & (ratios(errors[:3]) < 20.0)), errors
    assert errors[-1] < 1e-8


@pytest.mark.parametrize(("name", "parameters"), [("planar2", "reference"), ("tx40", "didim")])
def test_a_free_robot_without_friction_keeps_its_energy(name: str, parameters: str) -> None:
    """The drift is of fourth order or better; what moves is much larger than what is lost."""
    robot = didim.load_robot(name)
    x = without_friction(robot, robot.sets[parameters])
    rng = np.random.default_rng(0)
    q, dq = rng.uniform(-1.0, 1.0, (2, robot.n_dof))
    drifts, exchanged = [], 0.0
    for parts in (1, 2, 4, 8):
        run = free(robot, x, q, dq, 1.0, 6.25e-3 / parts, 20.0)
        total = energy(robot, run, x)
        drifts.append(float(np.abs(total - total[0]).max()))
        exchanged = float(np.ptp(potential_energy(robot, run.q, x)))
    assert np.all(ratios(drifts)[1:] > 14.0), drifts
    assert drifts[-1] < 1e-6 * exchanged
    assert exchanged > 5.0


def test_the_estimate_of_the_integration_error_is_the_error() -> None:
    robot, x, reference, controller = planar()
    options: dict[str, Any] = {"rate_hz": 20.0}
    run = didim.simulate(robot, x, reference, controller, step=2e-3, fine_step=2e-3, **options)
    exact = didim.simulate(robot, x, reference, controller, step=1e-4, fine_step=1e-4, check=False, **options)
    assert run.error is not None
    assert exact.error is None
    np.testing.assert_allclose(run.error.q, np.abs(run.q - exact.q).max(axis=0), rtol=0.05)
    true = np.sqrt(np.mean((run.tau - exact.tau) ** 2, axis=0))
    np.testing.assert_allclose(run.error.tau, true, rtol=0.05)
    share = true / np.sqrt(np.mean(exact.tau**2, axis=0))
    assert run.error.tau_relative == pytest.approx(share.max(), rel=0.05)
    assert not run.error.large


# --- Power --------------------------------------------------------------------------------------------------------------


def test_drives_and_pushes_give_what_energy_and_friction_take() -> None:
    """The coupled wrist too: motor 6 turns, and rubs, with ``dq5 + dq6``."""
    smoothing = 0.2
    robot, x, reference, controller = tx40(smoothing)
    value = dict(zip(robot.parameter_names, x, strict=True))
    push = np.random.default_rng(3).uniform(-5.0, 5.0, (3, 6))
    run = didim.simulate(
        robot, x, reference, controller, duration_s=2.0, rate_hz=2000.0, external=(1.0, push), check=False
    )
    dq = run.dq
    s = np.tanh(dq / smoothing)
    loss = np.zeros(len(dq))
    for j in range(6):
        fv, fc, off = (value[f"{name}{j + 1}"] for name in ("Fv", "Fc", "Off"))
        loss += (fv * dq[:, j] + fc * s[:, j] + off) * dq[:, j]
    shaft = dq[:, 4] + dq[:, 5]
    # Fv6, Fc6 and the like contain the motor where it turns alone (24); this is what is left.
    loss += value["Fvm6"] * (shaft**2 - dq[:, 4] ** 2 - dq[:, 5] ** 2)
    loss += value["Fcm6"] * (np.tanh(shaft / smoothing) * shaft - s[:, 5] * dq[:, 5])
    between = np.array([np.interp(run.t, np.arange(3.0), push[:, j]) for j in range(6)]).T
    given = ((run.tau + between) * dq).sum(axis=1)
    balance = cumulative_simpson(given - loss, x=run.t, initial=0.0)
    total = energy(robot, run, x)
    np.testing.assert_allclose(total - total[0], balance, rtol=0, atol=1e-4)
    # Not for want of anything to balance: energy, friction and pushes all count.
    for power in (loss, (between * dq).sum(axis=1)):
        assert np.abs(cumulative_simpson(power, x=run.t, initial=0.0)).max() > 1.0
    assert np.ptp(total) > 10.0


# --- Lanes, threads, batches --------------------------------------------------------------------------------------------


def candidates(x: Array, m: int) -> Array:
    return np.asarray(x * np.random.default_rng(5).uniform(0.9, 1.1, (m, 1)))


def test_threads_and_neighbours_do_not_change_a_bit() -> None:
    robot, x, reference, controller = tx40()
    xs = candidates(x, 9)
    scale = np.random.default_rng(6).uniform(0.8, 1.2, (9, 6))
    options: dict[str, Any] = {"duration_s": 0.2, "rate_hz": 100.0}
    runs = [
        didim.simulate(robot, xs, reference, controller, gain_scale=scale, threads=threads, **options)
        for threads in (1, 2)
    ]
    assert runs[0].q.shape == (9, 21, 6)
    assert runs[0].completed
    for name in ("q", "dq", "ddq", "tau"):
        np.testing.assert_array_equal(getattr(runs[0], name), getattr(runs[1], name))
    for k in range(9):
        alone = didim.simulate(
            robot, xs[k], reference, controller, gain_scale=scale[k], check=False, **options
        )
        for name in ("q", "dq", "ddq", "tau"):
            np.testing.assert_array_equal(getattr(alone, name), getattr(runs[0], name)[k])
    assert np.abs(runs[0].tau[0] - runs[0].tau[1]).max() > 0.1


def test_costs_are_sums_over_the_same_runs() -> None:
    robot, x, reference, controller = tx40()
    loop = ClosedLoop.of(robot, reference, controller, duration_s=0.2, rate_hz=100.0)
    xs = np.vstack([candidates(x, 5), robot.sets["didim_printed"]])
    (q, _, _, tau), outcomes = loop.run(xs)
    weight_q, weight_tau = np.arange(1.0, 7.0), np.linspace(0.1, 0.6, 6)
    costs, endings = loop.costs(xs, q[0], tau[0], weight_q=weight_q, weight_tau=weight_tau)
    assert endings == outcomes
    expected = (weight_q * (q - q[0]) ** 2).sum(axis=(1, 2)) + (weight_tau * (tau - tau[0]) ** 2).sum(
        axis=(1, 2)
    )
    np.testing.assert_allclose(costs[:5], expected[:5], rtol=1e-12)
    assert costs[0] == 0.0
    assert costs[1] > 0.0
    assert costs[5] == math.inf
    again, _ = loop.costs(xs, q[0], tau[0], weight_q=weight_q, weight_tau=weight_tau, threads=1)
    np.testing.assert_array_equal(again, costs)


def test_what_ends_early_is_not_a_number_from_there_on_and_leaves_its_neighbours_alone() -> None:
    robot, x, reference, controller = planar()
    wild = np.array([[1.0, 1.0], [-3.0, -3.0], [1.0, 1.0]])
    options: dict[str, Any] = {"duration_s": 0.5, "rate_hz": 200.0}
    batch = didim.simulate(robot, np.tile(x, (3, 1)), reference, controller, gain_scale=wild, **options)
    alone = [
        didim.simulate(robot, x, reference, controller, gain_scale=scale, check=False, **options)
        for scale in wild
    ]
    assert [outcome.status for outcome in batch.outcomes] == [
        SimulationStatus.COMPLETED,
        SimulationStatus.DIVERGED,
        SimulationStatus.COMPLETED,
    ]
    assert not batch.completed
    assert batch.outcome == batch.outcomes[1] == alone[1].outcome
    assert batch.outcome.time_s is not None
    ended = batch.t >= batch.outcome.time_s
    assert 0.1 < np.mean(ended) < 0.9
    for name in ("q", "dq", "ddq", "tau"):
        values = getattr(batch, name)
        for k in range(3):
            np.testing.assert_array_equal(values[k], getattr(alone[k], name))
        assert np.isnan(values[1, ended]).all()
        assert np.isfinite(values[1, ~ended]).all()
        assert np.isfinite(values[[0, 2]]).all()


MEMORY = """
import json, resource, sys
import numpy as np
from didim.loop.closed_loop import ClosedLoop
sys.path.insert(0, {tests!r})
from test_simulation import planar
robot, x, reference, controller = planar()
loop = ClosedLoop.of(robot, reference, controller, step=1e-3, fine_step=1e-3)
nothing = np.zeros((loop.n_records, 2))
one = np.ones(2)
peaks = []
for m in (64, 4096):
    costs, _ = loop.costs(np.tile(x, (m, 1)), nothing, nothing, weight_q=one, weight_tau=one)
    assert np.isfinite(costs).all() and costs.shape == (m,)
    peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
print(json.dumps([loop.n_records, *peaks]))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss is in KiB on Linux")
def test_the_memory_of_costs_does_not_grow_with_records_times_candidates() -> None:
    code = MEMORY.format(tests=str(__file__).rpartition("/")[0])
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    records, few, many = json.loads(done.stdout)
    # Trajectories of 2 joints would take this much (KiB); parameters, costs and outcomes take some.
    trajectories = 4096 * records * 2 * 4 * 8 / 1024
    assert trajectories > 250_000
    assert many - few < 0.1 * trajectories


LONG = """
import linecache, os, signal, sys
import numpy as np
from didim.loop.closed_loop import ClosedLoop
sys.path.insert(0, {tests!r})
from test_simulation import tx40
robot, x, reference, controller = tx40()
loop = ClosedLoop.of(robot, reference, controller)
nothing, one = np.zeros((loop.n_records, 6)), np.ones(6)
xs = np.tile(x, (50_000, 1))

def look(_, frame):
    # Inside the core a signal is heard only where the core asks for signals; there, not on the way, Ctrl-C comes.
    inside = "_core." in linecache.getline(frame.f_code.co_filename, frame.f_lineno)
    looked.append(inside)
    if looked[-3:] == [True] * 3:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        os.kill(os.getpid(), signal.SIGINT)

looked = []
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGALRM, look)
signal.setitimer(signal.ITIMER_REAL, 0.05, 0.05)
try:
    loop.costs(xs, nothing, nothing, weight_q=one, weight_tau=one)
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.slow
def test_ctrl_c_stops_a_long_batch() -> None:
    """Unheard, the batch would go on for a quarter of an hour, and the wait for its end would run out."""
    code = LONG.format(tests=str(__file__).rpartition("/")[0])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.stdout, done.returncode) == ("interrupted\n", 0), done.stderr


# --- The TX40 of Table II -----------------------------------------------------------------------------------------------


def test_the_tx40_tracks_the_rich_reference() -> None:
    robot, x, reference, controller = tx40()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = didim.simulate(robot, x, reference, controller)
    assert run.completed
    assert run.status is SimulationStatus.COMPLETED
    assert str(run.outcome) == "completed"
    assert run.t[-1] == pytest.approx(10.0)
    target, speed, _ = reference.at(run.t)
    # A PD without feed-forward lags; a loop that only just holds would be off by tenths of a radian.
    assert np.abs(run.q - target).max() < 0.02
    assert np.abs(run.dq - speed).max() < 1.0
    assert run.error is not None
    assert run.error.tau_relative < 0.005
    # The torques are those that the inverse model gives along the motion.
    tau = didim.inverse_dynamics(robot, run.q, run.dq, run.ddq, x)
    np.testing.assert_allclose(run.tau, tau, rtol=0, atol=1e-9)


def test_table_2_as_printed_ends_with_joint_and_time() -> None:
    robot, _, reference, controller = tx40()
    run = didim.simulate(robot, robot.sets["didim_printed"], reference, controller)
    assert run.status is SimulationStatus.INDEFINITE
    assert run.outcome.joint is not None
    assert 1 <= run.outcome.joint <= 6
    assert run.outcome.time_s is not None
    assert 0.0 <= run.outcome.time_s < 10.0
    joint, when = run.outcome.joint, run.outcome.time_s
    assert str(run.outcome) == (
        f"ended at {when:.4g} s: M(q) is not positive definite, the inertia at joint {joint} is not "
        "positive with these parameters"
    )
    assert "M(q) is not positive definite" in run.status.value
    assert run.error is None
    assert np.isnan(run.q[-1]).all()
    # Where it ended M(q) is indefinite indeed, and so is the block of the joints from the named one on.
    q, _, _ = reference.at(when)
    M = didim.inertia_matrix(robot, q, robot.sets["didim_printed"])[0]
    assert np.linalg.eigvalsh(M)[0] <= 0.0


def test_an_indefinite_matrix_on_the_way_is_found_there() -> None:
    """``det M = ZZ1 ZZ2 - (d2 MX2 cos q2)^2`` without masses: definite at a right angle, indefinite below 45 degrees."""
    robot = didim.load_robot("planar2")
    names = robot.parameter_names
    x = np.zeros(len(names))
    x[[names.index(name) for name in ("ZZ1", "ZZ2", "MX2")]] = [0.1, 0.2, 0.4]
    reference = Reference.point_to_point([[0.0, 1.5], [0.0, 0.0]], max_velocity=1.0, max_acceleration=4.0)
    run = didim.simulate(robot, x, reference, Controller.pd([400.0, 400.0], [40.0, 40.0]), rate_hz=1000.0)
    assert run.status is SimulationStatus.INDEFINITE
    assert run.outcome.time_s is not None
    recorded = np.isfinite(run.q[:, 0])
    assert recorded[0]
    assert not recorded[-1]
    matrices = didim.inertia_matrix(robot, run.q[recorded], x)
    smallest = np.linalg.eigvalsh(matrices)[:, 0]
    assert np.all(smallest > 0.0)
    assert smallest[-1] < 0.1 * smallest[0]
    assert run.t[recorded][-1] < run.outcome.time_s <= run.t[recorded][-1] + 1.1e-3


# --- Endings and warnings -----------------------------------------------------------------------------------------------


def test_unstable_gains_diverge_with_joint_and_time() -> None:
    robot, x, reference, controller = tx40()
    # One joint with gains of the wrong sign.
    run = didim.simulate(robot, x, reference, controller, gain_scale=[1.0, 1.0, 1.0, 1.0, -0.1, 1.0])
    assert run.status is SimulationStatus.DIVERGED
    assert run.outcome.joint == 5
    assert run.outcome.time_s is not None
    assert 0.0 < run.outcome.time_s < 10.0
    assert (
        str(run.outcome)
        == f"diverged at {run.outcome.time_s:.4g} s: joint 5 has left its reference; the controller "
        "does not hold this robot, or the step is too large"
    )
    assert run.error is None
    # All joints, with gains that a continuous controller may have and a late sampled one may not.
    inertia = mean_inertia(robot, x, reference)
    late = Digital(sample_time_s=1e-3, delay_samples=1)
    for digital, status in ((None, SimulationStatus.COMPLETED), (late, SimulationStatus.DIVERGED)):
        fast = Controller.tuned(100.0, 0.7, inertia, digital=digital)
        run = didim.simulate(robot, x, reference, fast, duration_s=1.0, check=False)
        assert run.status is status


def test_a_robot_that_exists_diverges_and_is_not_called_indefinite() -> None:
    """Within one step of a violent divergence angles of 1e20 rad are met."""
    robot, x, reference, controller = planar()
    scale = np.outer([-10.0, -30.0, -100.0, -300.0], [1.0, 1.0])
    run = didim.simulate(robot, np.tile(x, (4, 1)), reference, controller, gain_scale=scale)
    assert {outcome.status for outcome in run.outcomes} == {SimulationStatus.DIVERGED}


def test_a_bound_of_divergence_is_kept() -> None:
    robot, x, reference, controller = planar()
    run = didim.simulate(robot, x, reference, controller, start=([0.8, -0.6], [0.0, 0.0]), divergence=0.3)
    assert run.outcome == Outcome(SimulationStatus.DIVERGED, run.outcome.time_s, 1)


def test_a_step_of_ten_milliseconds_is_too_large_for_the_tx40() -> None:
    robot, x, reference, controller = tx40()
    options: dict[str, Any] = {"step": 1e-2, "fine_step": 1e-2, "rate_hz": 100.0}
    run = didim.simulate(robot, x, reference, controller, **options)
    assert run.status is SimulationStatus.DIVERGED
    assert str(run.outcome).endswith("or the step is too large")
    # With a softer controller it gets through, and the estimate tells.
    soft = Controller.tuned(6.0, 0.7, mean_inertia(robot, x, reference))
    with pytest.warns(StepWarning, match=r"^the step is too large: .*reduce step and fine_step$"):
        run = didim.simulate(robot, x, reference, soft, **options)
    assert run.completed
    assert run.error is not None
    assert run.error.large


def test_a_step_is_checked_for_one_candidate_or_on_request() -> None:
    robot, x, reference, controller = tx40()
    options: dict[str, Any] = {"step": 1e-3, "fine_step": 1e-3, "duration_s": 1.0}
    with pytest.warns(StepWarning, match="halving it changes the torque by"):
        one = didim.simulate(robot, x, reference, controller, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert didim.simulate(robot, x, reference, controller, check=False, **options).error is None
        assert didim.simulate(robot, [x, x], reference, controller, **options).error is None
    with pytest.warns(StepWarning):
        many = didim.simulate(robot, [x, x], reference, controller, check=True, **options)
    assert one.error is not None
    assert many.error is not None
    np.testing.assert_array_equal(one.error.tau, many.error.tau)


def test_friction_by_sign_and_by_a_narrow_tanh_agree_in_motion() -> None:
    """Away from reversals; and steps are fine only where a velocity is near zero."""
    sign = didim.load_robot("emps")
    narrow = sign.with_smoothing([1e-3])
    x = sign.sets["published"]
    reference = Reference.point_to_point([[0.0], [0.2]], max_velocity=0.2, max_acceleration=2.0, dwell_s=0.1)
    controller = Controller.tuned(20.0, 1.0, x[9])
    runs = [didim.simulate(robot, x, reference, controller, rate_hz=100.0) for robot in (sign, narrow)]
    moving = np.abs(reference.at(runs[0].t)[1][:, 0]) > 0.05
    np.testing.assert_allclose(runs[0].tau[moving], runs[1].tau[moving], rtol=1e-2)
    fine = ClosedLoop.of(narrow, reference, controller, step=1e-3, fine_step=1e-4, rate_hz=100.0)
    rest, travel = 0.2, reference.duration - 0.2
    slow = 2.0 * 10.0 * 1e-3 / 2.0
    assert fine.schedule.steps == pytest.approx((rest + slow) / 1e-4 + (travel - slow) / 1e-3, rel=0.05)


# --- Wrong calls --------------------------------------------------------------------------------------------------------

ROBOT, X, REFERENCE, CONTROLLER = planar()


def call(**changes: Any) -> Simulation:
    parts = {"robot": ROBOT, "x": X, "reference": REFERENCE, "controller": CONTROLLER}
    return didim.simulate(**{**parts, **changes})


def loop() -> ClosedLoop:
    return ClosedLoop.of(ROBOT, REFERENCE, CONTROLLER, rate_hz=100.0)


def cost(x: Any = X[None], **changes: Any) -> object:
    nothing, one = np.zeros((101, 2)), np.ones(2)
    options = {"q": nothing, "tau": nothing, "weight_q": one, "weight_tau": one}
    return loop().costs(np.asarray(x), **{**options, **changes})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: call(x=X[:-1]), "x must have shape (28,) for robot 'planar2', got (27,)"),
        (lambda: call(x=np.tile(X[:-1], (3, 1))), "x must have shape (28,) for robot 'planar2', got (27,)"),
        (lambda: call(x=np.zeros((2, 2, 28))), "x must have shape (28,) for robot 'planar2', got (2, 2, 28)"),
        (lambda: call(x=np.zeros((0, 28)), check=True), "x holds no candidate"),
        (lambda: call(x=X * math.nan), "x has nan for parameter XX1"),
        (lambda: call(x=[[1.0, 2.0], [1.0]]), "x must be an array of real numbers"),
    ],
)
def test_wrong_parameters_are_one_sentence(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ShapeError) as caught:
        make()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: call(duration_s=3.0), "the reference starts at 0 s and ends at 1 s, before the run, at 3 s"),
        (lambda: call(controller=Controller.pd(1.0, 1.0)), "the controller has 1 joints and robot 'planar2' has 2"),
        (lambda: call(reference=still(3, 1.0)), "the reference has 3 joints and robot 'planar2' has 2"),
        (lambda: call(rate_hz=0.0), "rate_hz must be positive, got 0"),
        (lambda: call(rate_hz=math.nan), "rate_hz must be positive, got nan"),
        (lambda: call(rate_hz=1e12), "duration_s must be positive and make at most 20000000 records of all joints"),
        (lambda: call(duration_s=-1.0), "records of all joints, got -1.0 s at 1000 Hz"),
        (lambda: call(step=1e-12), "step of 1e-12 s is too small for a run of"),
        (lambda: call(fine_step=1e-9), "fine_step of joint 1 is 1e-09 s, less than 0.0001 of the step of 0.0005 s"),
        (lambda: call(duration_s=1e-6), "a simulation needs at least 2 records, got 1"),
        (lambda: call(step=0.0), "step must be positive, got 0"),
        (lambda: call(fine_step=math.nan), "fine step must be positive, got NaN"),
        (lambda: call(fine_step=1e-300), "fine_step of joint 1 is 1e-300 s, less than 0.0001 of the step"),
        (lambda: call(gain_scale=[1.0] * 3), "gain_scale must have shape (2,) or (1, 2) and be finite"),
        (lambda: call(gain_scale=[1.0, math.nan]), "gain_scale must have shape (2,) or (1, 2) and be finite"),
        (lambda: call(x=[X, X], gain_scale=np.ones((3, 2))), "gain_scale must have shape (2,) or (2, 2)"),
        (lambda: call(start=([0.0, 0.0], [0.0] * 3)), "start needs 2 finite positions and 2 velocities"),
        (lambda: call(start=([0.0, 0.0],)), "start needs 2 finite positions and 2 velocities"),
        (lambda: call(start=([0.0, math.nan], [0.0, 0.0])), "start needs 2 finite positions and 2 velocities"),
        (lambda: call(external=(1.0, np.zeros((5, 3)))), "external needs finite torques of shape (n_samples, 2)"),
        (lambda: call(external=(1.0, np.zeros(5))), "external needs finite torques of shape (n_samples, 2)"),
        (lambda: call(external=(1.0, np.zeros((0, 2)))), "external needs finite torques of shape (n_samples, 2)"),
        (lambda: call(external=(1.0, [[0.0, math.nan]])), "external needs finite torques of shape (n_samples, 2)"),
        (lambda: call(external=(-1.0, np.zeros((5, 2)))), "the rate of external must be positive, got -1"),
        (lambda: call(external=(1.0,)), "external must be a rate (Hz) and torques"),
        (lambda: call(divergence=0.0), "divergence must be positive, got 0"),
        (lambda: call(divergence=math.nan), "divergence must be positive, got nan"),
        (lambda: call(threads=0), "threads must be a whole number from 1 to 4096, got 0"),
        (lambda: call(threads=-1), "threads must be a whole number from 1 to 4096, got -1"),
        (lambda: loop().run(X), "x must have shape (n_candidates, n_parameters), got (28,)"),
        (lambda: loop().run(X[None], gain_scale=np.ones((1, 3))), "scale must have shape (1, 2)"),
        (lambda: cost(X), "x must have shape (n_candidates, n_parameters), got (28,)"),
        (lambda: cost(X[None, :-1]), "x must have shape (m, 28)"),
        (lambda: cost(q=np.zeros((100, 2))), "got (100, 2)"),
        (lambda: cost(tau=np.zeros((2, 101))), "tau must have the shape of q, (101, 2), got (2, 101)"),
        (lambda: cost(q=np.full((101, 2), math.nan)), "q is NaN at sample 1, column 1"),
        (lambda: cost(weight_q=np.ones(3)), "the weights need 2 entries, one per joint"),
        (lambda: cost(gain_scale=np.ones((2, 2))), "1 candidates need 1 rows of scale"),
    ],
)  # fmt: skip
def test_parts_that_do_not_fit_are_one_sentence(make: Callable[[], object], message: str) -> None:
    with pytest.raises(SimulationError) as caught:
        make()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
