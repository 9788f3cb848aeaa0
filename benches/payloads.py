"""Currents, payloads and several logs: bias and calibration over seeds, real logs, and the observer.

    python benches/payloads.py [--data ../shared/data] [--seeds 40] [--only gains tx40 payload push ur10e]

gains, tx40: drive gains of a simulated UR5e (and of a TX40 with its coupled wrist, motor side) from two motions, one with a load of
which only the mass is known, by maximum likelihood.
payload, push: `didim payload` and `didim residual` on simulated logs. ur10e: a real pair.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import didim
from didim.log.recording import Recording
from didim.regression.gains.maximum_likelihood import drive_gains, expected_percent, expected_sentence
from didim.regression.settings import LeastSquaresSettings
from didim.robot.payload import Payload, flange_in_last_frame, last_link
from didim.robot.rigid_body import body_pseudo_inertia, pose, ten_parameters
from didim.robot.robot import Robot
from didim.signal.processing import SignalProcessing
from didim.signal.window import Window
from didim.studies.loads.payload import identify_payload
from didim.studies.loads.residual import residual_torques
from didim.terms.build import model_of
from didim.terms.model import Model
from didim.terms.rows import LinearSystem

Array = NDArray[np.float64]

VISCOUS = (8.0, 8.0, 6.0, 2.0, 2.0, 2.0)
ROTORS = (1.0, 1.0, 0.6, 0.2, 0.2, 0.2)
GAINS = np.array([12.5, 12.5, 10.5, 10.4, 10.2, 10.3])
NOISE = np.array([0.4, 0.4, 0.3, 0.15, 0.15, 0.15])
LOAD = ten_parameters(
    body_pseudo_inertia(3.0, np.diag([0.02, 0.02, 0.015]), pose(np.eye(3), (0.02, 0.05, 0.12)))
)
SIGNAL = SignalProcessing(cutoff_hz=None)
WHITE = LeastSquaresSettings(weights="per-joint", uncertainty="white")


def motion(seed: int, speed: float = 1.0) -> tuple[Array, Array, Array]:
    """Random Fourier motion of 20 s at 40 Hz."""
    reference = didim.Reference.random_fourier(
        harmonics=14,
        period_s=20.0,
        max_position=[2.5] * 6,
        max_velocity=[2.0 * speed] * 6,
        max_acceleration=[6.0 * speed] * 6,
        seed=seed,
    )
    q, dq, ddq = reference.at(np.arange(0.0, 20.0, 0.025))
    return q, dq, ddq


def ur5e(data: Path) -> tuple[Robot, Array]:
    """UR5e of a URDF with made-up rotors and friction, and its standard parameters."""
    robot = didim.load_robot(data / "urdf" / "ur5e.urdf").with_smoothing([0.02] * 6)
    x = robot.parameter_set("urdf").copy()
    for j in range(6):
        for key, values in (("Fv", VISCOUS), ("Fc", VISCOUS), ("Ia", ROTORS)):
            x[robot.parameter_names.index(f"{key}{j + 1}")] = values[j]
    return robot, x


def tx40() -> tuple[Robot, Array]:
    """TX40 with the parameters of its packaged set."""
    robot = didim.load_robot("tx40").with_smoothing([0.02] * 6)
    return robot, robot.parameter_set("didim")


def two_logs(robot: Robot, x: Array, drives: Array, speed: float = 1.0) -> tuple[LinearSystem, Model, Array]:
    """System of two motions, the second with the load; its torques without noise, and all true parameters but the gains."""
    frame = flange_in_last_frame(robot)
    loaded = x + last_link(robot, frame) @ LOAD
    recordings, parts = [], []
    for number, (values, payload) in enumerate(((x, "none"), (loaded, "load"))):
        q, dq, ddq = motion(number + 1, speed)
        tau = didim.inverse_dynamics(robot, q, dq, ddq, values)
        item = Recording.from_arrays(q, tau, rate_hz=40.0, name=payload)
        recordings.append(replace(item, payload=payload, drives=tuple(map(tuple, drives.tolist()))))
        parts.append(
            Window(name=payload, place=payload, rate_hz=40.0, q=q, dq=dq, ddq=ddq, tau=tau, recording=number)
        )
    parameters = model_of(robot, recordings, {"load": Payload(name="load", mass_kg=3.0)})
    system = parameters.rows(parts, SIGNAL)
    return system, parameters, np.concatenate([robot.base_parameters.project(x), LOAD[:9]])


def gains_study(
    name: str, robot: Robot, x: Array, drives: Array, gains: Array, noise: Array, seeds: int, speed: float
) -> None:
    """Bias and calibration of drive gains by maximum likelihood."""
    system, _, theta = two_logs(robot, x, drives, speed)
    n = robot.n_dof
    torque = system.measured.reshape(n, -1)
    motor = np.linalg.inv(drives).T @ torque
    found, scores, sigma, moved = [], [], [], 0.0
    truth = np.concatenate([theta, gains])
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        current = motor / gains[:, None] + rng.standard_normal(motor.shape) * noise[:, None]
        known = np.zeros(torque.size) if system.known is None else system.known
        noisy = replace(system, y=(drives.T @ current).ravel() - known)
        fit = drive_gains(noisy, drives, WHITE)
        off = drive_gains(noisy, drives, WHITE, start=0.7 * gains)
        moved = max(moved, float(np.abs(off.gains / fit.gains - 1.0).max()))
        std = np.sqrt(np.diag(fit.fit.covariance))
        scores.append((fit.fit.solution - truth) / std)
        sigma.append(std[-n:])
        found.append(fit.gains)
        if seed == 0:
            print(
                f"{name}: {expected_sentence(expected_percent(noisy, drives))}; {fit.iterations} iterations"
            )
    row = "".join
    print(f"{'true':20}", row(f"{value:10.4g}" for value in gains))
    many = np.array(found)
    print(f"{'mean':20}", row(f"{value:10.4g}" for value in many.mean(axis=0)))
    print(f"{'spread':20}", row(f"{value:10.3g}" for value in many.std(axis=0)))
    print(f"{'its sigma':20}", row(f"{value:10.3g}" for value in np.mean(sigma, axis=0)))
    score = np.array(scores)
    for title, part in (("gains", score[:, -n:]), ("all parameters", score)):
        print(
            f"error/sigma of {title}: rms {np.sqrt(np.mean(part**2)):.3f}, within 1.96: {100 * np.mean(np.abs(part) < 1.96):.1f} %"
        )
    bias = many.mean(axis=0) - gains
    print(f"mean error over its own sigma: {np.round(bias / np.mean(sigma, axis=0) * np.sqrt(seeds), 2)}")
    print(f"starting gains 30 % off move them by {moved:.1e}")


def gains(options: argparse.Namespace) -> None:
    """UR5e, currents of the joints."""
    robot, x = ur5e(options.data)
    gains_study("UR5e", robot, x, np.eye(6), GAINS, NOISE, options.seeds, 1.0)


def wrist(options: argparse.Namespace) -> None:
    """TX40 with its coupled wrist, currents of the motors."""
    robot, x = tx40()
    assert robot.reduction is not None
    motor_gains = np.array([0.35, 0.35, 0.25, 0.2, 0.15, 0.15])
    noise = np.array([0.15, 0.15, 0.1, 0.05, 0.05, 0.05])
    gains_study("TX40", robot, x, robot.reduction, motor_gains, noise, options.seeds, 2.0)


def known_robot(
    robot: Robot,
    x: Array,
    seed: int,
    rate: float = 200.0,
    uncertainty: Literal["jackknife", "decimated"] = "jackknife",
) -> didim.Identification:
    """Result of a log of 20 s without payload, with noise on the torques."""
    return didim.identify(noisy_log(robot, x, seed, rate, uncertainty=uncertainty), didim.IDIMLS())


def noisy_log(
    robot: Robot,
    x: Array,
    seed: int,
    rate: float = 200.0,
    speed: float = 2.0,
    uncertainty: Literal["jackknife", "decimated"] = "jackknife",
) -> didim.Experiment:
    """Log of 20 s of a random motion, filtered and decimated to 20 Hz."""
    n = robot.n_dof
    reference = didim.Reference.random_fourier(
        harmonics=14,
        period_s=20.0,
        max_position=[1.8] * n,
        max_velocity=[speed] * n,
        max_acceleration=[3.0 * speed] * n,
        seed=seed,
    )
    q, dq, ddq = reference.at(np.arange(0.0, 20.0, 1.0 / rate))
    tau = didim.inverse_dynamics(robot, q, dq, ddq, x)
    tau += np.random.default_rng(seed).standard_normal(tau.shape) * np.array(TORQUE_NOISE)
    return didim.Experiment(
        name=f"log {seed}",
        robot=robot,
        recordings=(Recording.from_arrays(q, tau, rate_hz=rate),),
        signal=SignalProcessing(cutoff_hz=40.0, trim_start=40, trim_end=40, decimation=(10,)),
        least_squares=LeastSquaresSettings(weights="per-joint", uncertainty=uncertainty),
    )


TORQUE_NOISE = (2.0, 2.0, 1.5, 0.5, 0.5, 0.5)


def payload(options: argparse.Namespace) -> None:
    """Random payloads of 0.2 to 5 kg on a UR5e that another log identified."""
    robot, x = ur5e(options.data)
    frame = flange_in_last_frame(robot)
    rng = np.random.default_rng(1)
    scores, bodies, inside = [], [], []
    for number in range(options.payloads):
        fit = known_robot(robot, x, 100 + number, uncertainty=options.uncertainty)
        mass = float(np.exp(rng.uniform(np.log(0.2), np.log(5.0))))
        centre = rng.uniform(-0.1, 0.1, 3) + np.array([0.0, 0.0, 0.1])
        arms = rng.uniform(0.02, 0.08, 3) ** 2 * mass
        inertia = np.diag([arms[1] + arms[2], arms[0] + arms[2], arms[0] + arms[1]])
        ten = ten_parameters(body_pseudo_inertia(mass, inertia, pose(np.eye(3), centre)))
        loaded = x + last_link(robot, frame) @ ten
        log = noisy_log(robot, loaded, 200 + number, uncertainty=options.uncertainty)
        found = identify_payload(fit, log)
        scores.append((found.ten - ten) / found.std)
        truth = np.array([mass, *centre, *inertia[np.triu_indices(3)]])
        assert found.body is not None
        assert found.body_std is not None
        assert found.body_low is not None
        assert found.body_high is not None
        bodies.append((found.body - truth) / found.body_std)
        inside.append((found.body_low <= truth) & (truth <= found.body_high))
        shown = ", ".join(f"{value:.1f}" for value in 1e3 * found.body[1:4])
        print(
            f"{mass:6.3f} kg: {found.body[0]:6.3f} +- {found.body_std[0]:.3f} kg, centre {shown} mm "
            f"(true {', '.join(f'{value:.1f}' for value in 1e3 * centre)}), half distance {found.half_distance:.2f}"
        )
    squares = np.mean(np.square(scores), axis=1)
    level = float(np.sqrt(np.mean(squares)))
    chance = float(np.std(squares, ddof=1)) / (2.0 * level * np.sqrt(len(squares)))
    print(
        f"error/sigma of the ten parameters about the flange, {len(squares)} payloads: rms {level:.3f} +- {chance:.3f}"
    )
    body = np.array(bodies)
    print(
        f"of the nearest body: mass and centre {np.sqrt(np.mean(body[:, :4] ** 2)):.3f}, inertia "
        f"{np.sqrt(np.mean(body[:, 4:] ** 2)):.3f}; inside 95 %: {100 * np.mean(inside):.0f} %"
    )


def ur10e(options: argparse.Namespace) -> None:
    """Weigh the load of a real pair: gains, centre, and the mass with gains given."""
    file = Path(__file__).resolve().parents[1] / "examples" / "ur10e_currents.toml"
    experiment = didim.load_experiment(file, data=options.data / "ur10e")
    fit = didim.identify(experiment, didim.IDIMLS())
    assert fit.further is not None
    print("\n".join(fit.further.lines(fit.interval_factor())))
    prototype = np.array([10.56, 12.38, 9.95, 10.38, 10.27, 10.31])
    torques = replace(
        experiment,
        recordings=tuple(item.with_gains(prototype) for item in experiment.recordings),
        payloads={"load": Payload(name="load")},
    )
    weighed = didim.identify(torques, didim.IDIMLS())
    assert weighed.further is not None
    print(
        f"mass with the gains of a prototype: {weighed.further.values[-1]:.3f} +- {weighed.further.std[-1]:.3f} kg (2.805)"
    )
    free, loaded = (replace(torques, recordings=(item,)) for item in torques.recordings)
    found = identify_payload(didim.identify(free, didim.IDIMLS()), replace(loaded, payloads=torques.payloads))
    print(found)


def push(options: argparse.Namespace) -> None:
    """Latency of the observer for 5 N.m at joint 3 of a UR5e, and what it reports on clean logs."""
    robot, x = ur5e(options.data)
    fit = known_robot(robot, x, 100)
    rate, latencies, seen, false_alarms, changes = 500.0, [], 0, 0, 0
    limits = []
    for number in range(options.payloads):
        log = noisy_log(robot, x, 300 + number, rate)
        found = residual_torques(fit, log)
        false_alarms += sum(len(item.contacts) for item in found.windows)
        changes += sum(item.payload_change is not None for item in found.windows)
        limits.append(np.median(found.windows[0].limits, axis=0))
        (item,) = log.recordings
        assert item.tau is not None
        start = 6.0 + 0.73 * number % 8.0
        tau = item.tau.copy()
        tau[(item.t >= start) & (item.t < start + 0.5), 2] -= 5.0
        pushed = residual_torques(fit, replace(log, recordings=(replace(item, tau=tau),)))
        near = [
            contact.start_s - start
            for contact in pushed.windows[0].contacts
            if 3 in contact.joints and -0.01 <= contact.start_s - start < 0.5
        ]
        seen += bool(near)
        latencies += near[:1]
    print(
        f"clean logs of 20 s: {options.payloads}, contacts reported {false_alarms}, payload changes {changes}"
    )
    print(f"limits of the observer, median: {np.round(np.mean(limits, axis=0), 2)} N.m")
    if latencies:
        print(
            f"5 N.m at joint 3: {seen} of {options.payloads} reported, after {1e3 * np.median(latencies):.0f} ms "
            f"(median), {1e3 * max(latencies):.0f} ms at most"
        )


STUDIES: dict[str, Callable[[argparse.Namespace], None]] = {
    "gains": gains,
    "tx40": wrist,
    "payload": payload,
    "push": push,
    "ur10e": ur10e,
}


def main() -> None:
    """Run the studies."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--data", type=Path, default=Path("../shared/data"), help="measured logs and URDFs of others"
    )
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--payloads", type=int, default=10)
    parser.add_argument(
        "--uncertainty",
        choices=("jackknife", "decimated"),
        default="jackknife",
        help="of the study of payloads: the noise of its logs is white, which decimated takes for granted (default: %(default)s)",
    )
    parser.add_argument("--only", nargs="+", choices=tuple(STUDIES), default=list(STUDIES))
    options = parser.parse_args()
    for name in options.only:
        print(f"== {name}")
        STUDIES[name](options)


if __name__ == "__main__":
    main()
