"""Designed motions beside random ones, on three robots: what they gain, and that they hold what they promise.

    python benches/excitation.py                    # all four studies
    python benches/excitation.py tx40 urdf          # ratios to the random motion, from several starts each
    python benches/excitation.py circle             # designed, simulated with noise, identified
    python benches/excitation.py prior              # a poor first log, and a second design that knows of it
    python benches/excitation.py capsules           # random designs of an arm with capsules, against Pinocchio's own geometry

The robots other than the TX40 come from URDFs in ../shared; ``capsules`` needs Pinocchio. docs/excitation.md has the results.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import didim
from didim.excitation.problem import FINE
from didim.loop.reference import Reference
from didim.model.kinematics import frames

Array = NDArray[np.float64]

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data" / "urdf"
REACH = (2.6, 1.8, 2.0, 3.5, 1.9, 4.0)
"""Position limits of the packaged experiment (rad), about zero; its others follow."""
VELOCITY = (4.5, 4.5, 6.5, 6.5, 5.0, 10.0)
ACCELERATION = (25, 25, 35, 60, 60, 90)
NOISE = (0.5, 0.5, 0.2, 0.1, 0.1, 0.1)


def random_motion() -> Reference:
    """The random motion of the packaged experiment, as it is."""
    return Reference.random_fourier(
        harmonics=20,
        period_s=10.0,
        max_position=REACH,
        max_velocity=VELOCITY,
        max_acceleration=ACCELERATION,
        seed=1,
    )


def rich_peaks() -> Array:
    """Torque peaks of the packaged experiment's random motion: a design must not ask for more."""
    robot = didim.load_robot("tx40").with_smoothing([0.05] * 6)
    motion = random_motion().at(np.linspace(0.0, 10.0, 8001))
    return np.asarray(np.abs(didim.inverse_dynamics(robot, *motion, robot.sets["didim"])).max(axis=0))


def tx40_settings(**more: object) -> didim.excitation.ExcitationSettings:
    """The packaged experiment as a design: its limits, its noise, its length, and torques as the random motion has them."""
    settings = didim.excitation.ExcitationSettings(
        margin=1.0,
        start=[0.0] * 6,
        position=[(-reach, reach) for reach in REACH],
        velocity=VELOCITY,
        acceleration=ACCELERATION,
        torque=rich_peaks().tolist(),
        torque_noise=NOISE,
        log_rate_hz=1000.0,
        parameters="didim",
    )
    return replace(settings, **more)  # type: ignore[arg-type]


def row(name: str, design: didim.Excitation, random: Array, seconds: float, processor: float) -> float:
    """Print one line of a study, and return the ratio of standard deviations to those of a random motion."""
    ratio = float(np.exp(np.mean(np.log(design.std / random))))
    use = max(float(values.max()) for values in design.use.values())
    print(
        f"{name:12} log det {design.log_det:8.2f}  ratio {ratio:.3f}  condition number {design.condition_number:6.0f} "
        f"(random {design.random_condition_number:6.0f})  largest use {use:.6f}  {seconds:5.1f} s, processor {processor:4.1f} s",
        flush=True,
    )
    return ratio


def timed(
    robot: didim.Robot, settings: didim.excitation.ExcitationSettings
) -> tuple[didim.Excitation, float, float]:
    """A design, its seconds, and those of the processor."""
    wall, processor = time.perf_counter(), time.process_time()
    design = didim.excite(robot, settings)
    return design, time.perf_counter() - wall, time.process_time() - processor


def tx40(starts: int) -> None:
    """The TX40 from several starts, each by itself; then the two starts of the default on two threads."""
    print("TX40, 10 s, 20 harmonics, torques at most those of the random motion of seed 1")
    robot = didim.load_robot("tx40")
    smooth = robot.with_smoothing([0.05] * 6)
    motion = random_motion().at(np.arange(4000) / 400.0)
    columns = list(robot.base_parameters.indices)
    w = didim.regressor(smooth, *motion)[:, :, columns] / np.array(NOISE)[:, None]
    w = w.reshape(-1, len(columns)) * np.sqrt(10_000 / 4000)
    std = np.sqrt(np.diag(np.linalg.inv(w.T @ w)))
    ratios, values = [], []
    for seed in range(1, starts + 1):
        settings = tx40_settings(seed=seed, starts=1)
        design, seconds, processor = timed(robot, settings)
        ratios.append(row(f"seed {seed}", design, std, seconds, processor))
        values.append(design.log_det)
    print(f"largest ratio {max(ratios):.3f}, spread of log det {np.ptp(values):.2f}")
    design, seconds, processor = timed(robot, tx40_settings(seed=1, starts=2))
    row("two starts", design, std, seconds, processor)
    design, seconds, processor = timed(robot, tx40_settings(seed=1, starts=1, criterion="condition"))
    row("condition", design, std, seconds, processor)


def urdf(starts: int) -> None:
    """Two arms from their URDFs."""
    for name in ("ur5e", "panda"):
        robot = didim.load_robot(SHARED / f"{name}.urdf")
        print(f"{name}, 10 s, 12 harmonics, noise 0.2 N.m")
        for seed in range(1, starts + 1):
            settings = didim.excitation.ExcitationSettings(
                seed=seed, starts=1, harmonics=12, torque_noise=0.2, rate_hz=1000.0
            )
            design, seconds, processor = timed(robot, settings)
            row(f"seed {seed}", design, design.random_std, seconds, processor)


def circle(seeds: int) -> None:
    """Designed, simulated through the closed loop with noise, identified by DIDIM; the packaged random motion beside it."""
    experiment = didim.packaged_experiment("tx40")
    truth = experiment.robot.sets["didim"]
    beta = experiment.robot.base_parameters.project(truth)
    design = didim.excite(experiment.robot, tx40_settings(seed=1))
    print("DIDIM on the simulated TX40, three seeds of the noise")
    for name, source in (
        ("random", experiment),
        ("designed", replace(experiment, reference=design.reference)),
    ):
        logs = [didim.simulated_log(source, truth, seed=seed) for seed in range(seeds)]
        # The design predicts deviations for white noise: "decimated" counts what the decimation does to it.
        for kind in ("jackknife", "decimated"):
            std, error, percent = [], [], []
            for log in logs:
                fit = didim.identify(log, didim.DIDIM(physical=False), uncertainty=kind)
                std.append(fit.std)
                error.append((fit.beta - beta) / fit.std)
                percent.append(100.0 * fit.std / np.abs(beta))
            below = [int((values < 2.0).sum()) for values in percent]
            print(
                f"{name:9} {kind:10} error/sigma {np.sqrt(np.mean(np.square(error))):.3f}  below 2 %: {below} of {len(beta)}  "
                f"median sigma {np.median(percent):.2f} %",
                flush=True,
            )
    expected = float(np.exp(np.mean(np.log(np.mean(std, axis=0) / design.std))))
    print(f"sigma of DIDIM over the expected one, geometric mean: {expected:.3f}")


def prior() -> None:
    """A first log in which joint 4 stood still, and a second design that knows it."""
    experiment = didim.packaged_experiment("tx40")
    robot, truth = experiment.robot, experiment.robot.sets["didim"]
    print("TX40: a first log in which joint 4 stood still")
    still = [(-reach, reach) for reach in REACH]
    fresh = didim.excite(robot, tx40_settings(seed=1, periods=2))
    first = didim.excite(robot, tx40_settings(seed=3))
    table = dict(first.tables)
    sine, cosine = np.array(table["sine_rad"]), np.array(table["cosine_rad"])
    sine[:, 3], cosine[:, 3] = 0.0, 0.0
    motion = Reference.fourier(sine, cosine, period_s=10.0)
    log = didim.simulated_log(replace(experiment, reference=motion), truth)
    second = didim.excite(robot, tx40_settings(seed=2, prior=(log,), position=still))
    reach = np.ptp(second.sampled()[1], axis=0)
    print(f"the second design moves the joints by {np.round(reach, 2).tolist()} rad")
    together = second.std / fresh.std
    print(
        f"both logs over a fresh design of twice the length: geometric mean {np.exp(np.mean(np.log(together))):.3f}, "
        f"log det {second.log_det:.1f} and {fresh.log_det:.1f}"
    )
    blind = didim.excite(robot, tx40_settings(seed=2))
    alone = blind.information + second.information - _own(robot, second)
    ratio = np.sqrt(np.diag(np.linalg.inv(alone))) / fresh.std
    print(f"with a second design that does not know the first: {np.exp(np.mean(np.log(ratio))):.3f}")


def _own(robot: didim.Robot, design: didim.Excitation) -> Array:
    """Information of a design without its prior."""
    t, q, dq, ddq = design.sampled(1000.0)
    w = (
        didim.regressor(robot, q, dq, ddq)[:, :, list(robot.base_parameters.indices)]
        / np.array(NOISE)[:, None]
    )
    w = w.reshape(-1, w.shape[-1])
    return np.asarray(w.T @ w) * (10_000 / len(t))


def base_matrix(robot: didim.Robot) -> Array:
    """Frame 0 of a robot in the base link of its URDF."""
    assert robot.correspondence is not None
    return robot.correspondence.base_matrix


RADII = (0.07, 0.07, 0.055, 0.045, 0.04, 0.04, 0.04)
"""Radii (m) of the base and the links of a UR5e, roughly."""


def ur5e_capsules(
    robot: didim.Robot, model: object
) -> tuple[list[didim.excitation.Capsule], list[tuple[int, Array, Array, float]]]:
    """Capsules between the joints of the URDF, in the frames of the robot and in those of Pinocchio."""
    import pinocchio as pin

    data = model.createData()  # type: ignore[attr-defined]
    q = pin.neutral(model)
    pin.forwardKinematics(model, data, q)
    poses = [pin.SE3.Identity(), *list(data.oMi)[1:]]
    origins = [pose.translation for pose in poses]
    # Frame 0 of the robot lies on its first axis, not in the base link.
    own = base_matrix(robot) @ frames(robot, np.zeros((1, robot.n_dof)))[0]
    ours, theirs = [], []
    for link in range(robot.n_dof + 1):
        # The base ends below the shoulder, which the upper arm turns about.
        start = origins[link]
        end = (
            origins[link + (link > 0)]
            if link < robot.n_dof
            else start + poses[link].rotation @ [0.0, 0.0, 0.08]
        )
        inside = [own[link][:3, :3].T @ (point - own[link][:3, 3]) for point in (start, end)]
        ours.append(
            didim.excitation.Capsule(
                link=link, start=tuple(inside[0]), end=tuple(inside[1]), radius=RADII[link]
            )
        )
        theirs.append((link, *(poses[link].actInv(point) for point in (start, end)), RADII[link]))
    return ours, theirs


def capsules(count: int) -> None:
    """Random designs of a UR5e with capsules and a floor, each verified by Pinocchio's own kinematics and geometry."""
    import coal
    import pinocchio as pin

    path = SHARED / "ur5e.urdf"
    robot = didim.load_robot(path)
    model = pin.buildModelFromUrdf(str(path))
    ours, theirs = ur5e_capsules(robot, model)
    geometry = pin.GeometryModel()
    for index, (link, start, end, radius) in enumerate(theirs):
        length = float(np.linalg.norm(end - start))
        z = (end - start) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), z).toRotationMatrix()
        shape = coal.Capsule(radius, length) if length > 0.0 else coal.Sphere(radius)
        place = pin.SE3(rotation, (start + end) / 2.0)
        geometry.addGeometryObject(pin.GeometryObject(f"capsule {index}", link, place, shape))
    for i in range(len(theirs)):
        for j in range(i + 2, len(theirs)):
            geometry.addCollisionPair(pin.CollisionPair(i, j))
    data, geometry_data = model.createData(), pin.GeometryData(geometry)
    print(
        f"UR5e, {len(ours)} capsules, floor 0.1 m below the base, torques of the URDF: {count} random designs"
    )
    workspace = didim.excitation.Workspace(floor=-0.1 - float(base_matrix(robot)[2, 3]), clearance=0.005)
    rng = np.random.default_rng(0)
    collisions = 0
    for seed in range(count):
        settings = didim.excitation.ExcitationSettings(
            seed=seed,
            starts=1,
            harmonics=int(rng.integers(6, 13)),
            duration_s=float(rng.uniform(6.0, 12.0)),
            torque_noise=0.2,
            rate_hz=1000.0,
            capsules=ours,
            workspace=workspace,
        )
        design, seconds, processor = timed(robot, settings)
        fine = FINE * 20 * settings.harmonics
        q = design.reference.at(np.arange(fine) * (settings.duration_s / fine))[0]
        hits, nearest = 0, np.inf
        for pose in q:
            pin.updateGeometryPlacements(model, data, geometry, geometry_data, pose)
            hits += bool(pin.computeCollisions(geometry, geometry_data, True))
        for pose in q[:: FINE // 2]:
            pin.updateGeometryPlacements(model, data, geometry, geometry_data, pose)
            pin.computeDistances(geometry, geometry_data)
            nearest = min(nearest, *(result.min_distance for result in geometry_data.distanceResults))
        collisions += hits > 0
        name = design.nearest[0] if design.nearest else "-"
        print(
            f"seed {seed:2}: {hits} of {fine} poses collide, nearest {1e3 * nearest:.1f} mm ({name}), ratio {design.ratio:.3f}, "
            f"{seconds:.1f} s, processor {processor:.1f} s",
            flush=True,
        )
    print(f"designs with a self-collision: {collisions} of {count}")


STUDIES: dict[str, Callable[[int], None]] = {
    "tx40": lambda count: tx40(count or 10),
    "urdf": lambda count: urdf(count or 5),
    "circle": lambda count: circle(count or 3),
    "prior": lambda _: prior(),
    "capsules": lambda count: capsules(count or 20),
}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("studies", nargs="*", metavar="STUDY", help=f"of {', '.join(STUDIES)} (default: all)")
    parser.add_argument("--count", type=int, default=0, help="starts, seeds or designs of each study")
    options = parser.parse_args()
    for name in options.studies or STUDIES:
        if name not in STUDIES:
            parser.error(f"there is no study {name!r}; available: {', '.join(STUDIES)}")
        STUDIES[name](options.count)
    return 0


if __name__ == "__main__":
    sys.exit(main())
