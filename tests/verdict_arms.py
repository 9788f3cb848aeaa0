"""Arms with known truth for the verdict: a 7R arm and a gantry with a wrist, their logs, and faults planted in these.

Serves ``tests/test_verdict_faults.py`` and ``benches/verdicts.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim
from didim import Experiment, Robot
from didim.evidence.hypotheses.geometry import of_other_convention, with_geometry
from didim.experiment.loop import closed_loop
from didim.experiment.specs import ReferenceSpec, SimulationSettings
from didim.loop.controller import Controller
from didim.loop.reference import Reference
from didim.result.finding import Remedy
from didim.signal.processing import SignalProcessing
from didim.studies.simulated_log import simulated_log

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arm:
    """Rows of a robot (kind, alpha in degrees, a, d, both in m), by the standard convention, with bodies and a motion."""

    name: str
    rows: tuple[tuple[str, float, float, float], ...]
    masses: tuple[float, ...]
    rotors: tuple[float, ...]
    friction: tuple[float, ...]
    reach: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    offset: tuple[float, ...]
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    def text(self, **changes: Any) -> str:
        """Robot file; `changes` are fields of the arm, or `convention`."""
        convention = changes.pop("convention", "dh")
        arm = replace(self, **changes)
        lines = ["schema = 1", f'name = "{self.name}"', f'convention = "{convention}"']
        lines += [f"gravity_m_s2 = {list(arm.gravity)}", "[friction]", 'coulomb = "tanh"']
        kinds = {row[0] for row in arm.rows}
        lines += ["smoothing_rad_s = 0.02"] if "revolute" in kinds else []
        lines += ["smoothing_m_s = 0.005"] if "prismatic" in kinds else []
        for kind, alpha, a, d in arm.rows:
            along, across = ("a_m", "d_m") if convention == "dh" else ("d_m", "r_m")
            lines += ["[[joint]]", f'kind = "{kind}"', f"alpha_deg = {alpha}", f"{along} = {a}"]
            lines += ["theta_deg = 0.0", f"{across} = {d}"]
        return "\n".join(lines) + "\n"

    def load(self, **changes: Any) -> Robot:
        """Robot of the arm, or of a wrong file."""
        with TemporaryDirectory() as folder:
            file = Path(folder) / f"{self.name}.toml"
            file.write_text(self.text(**changes), encoding="utf-8")
            return didim.load_robot(file)

    def truth(self, robot: Robot) -> Array:
        """Standard parameters: rods with their centres of mass off the frames, rotors and friction."""
        values: dict[str, float] = {}
        for j, mass in enumerate(self.masses):
            centre = np.array([0.07, -0.05, 0.06]) * (1.0 if j % 2 else -1.0)
            inertia = mass * (
                np.diag([0.010, 0.012, 0.008]) + np.dot(centre, centre) * np.eye(3) - np.outer(centre, centre)
            )
            values |= {
                f"{key}{j + 1}": float(v) for key, v in zip(("MX", "MY", "MZ"), mass * centre, strict=True)
            }
            values |= {
                f"{key}{j + 1}": float(inertia[a, b])
                for key, (a, b) in {
                    "XX": (0, 0),
                    "XY": (0, 1),
                    "XZ": (0, 2),
                    "YY": (1, 1),
                    "YZ": (1, 2),
                    "ZZ": (2, 2),
                }.items()
            }
            values |= {
                f"M{j + 1}": mass,
                f"Ia{j + 1}": self.rotors[j],
                f"Off{j + 1}": 0.05 * self.friction[j],
            }
            values |= {f"Fc{j + 1}": self.friction[j], f"Fv{j + 1}": 0.8 * self.friction[j]}
        return np.array([values.get(name, 0.0) for name in robot.parameter_names])


ARM7 = Arm(
    name="arm7",
    rows=(
        ("revolute", -90.0, 0.0, 0.34),
        ("revolute", 90.0, 0.0, 0.0),
        ("revolute", 90.0, 0.08, 0.40),
        ("revolute", -90.0, -0.08, 0.0),
        ("revolute", -90.0, 0.0, 0.38),
        ("revolute", 90.0, 0.09, 0.0),
        ("revolute", 0.0, 0.0, 0.12),
    ),
    masses=(4.0, 4.0, 3.0, 3.0, 2.0, 1.5, 0.7),
    rotors=(0.6, 0.6, 0.4, 0.4, 0.15, 0.15, 0.08),
    friction=(3.0, 3.0, 2.0, 2.0, 1.0, 0.8, 0.5),
    reach=(1.5, 1.2, 1.5, 1.2, 1.5, 1.4, 2.0),
    speed=(2.0, 2.0, 2.5, 2.5, 3.0, 3.0, 4.0),
    acceleration=(8.0, 8.0, 10.0, 12.0, 16.0, 16.0, 25.0),
    offset=(0.0, 0.3, 0.0, -1.0, 0.0, 1.0, 0.0),
)
GANTRY = Arm(
    name="gantry",
    rows=(
        ("prismatic", -90.0, 0.0, 0.0),
        ("prismatic", -90.0, 0.0, 0.0),
        ("prismatic", -90.0, 0.15, 0.0),
        ("revolute", 90.0, 0.20, 0.10),
        ("revolute", 0.0, 0.0, 0.15),
    ),
    masses=(20.0, 12.0, 8.0, 5.0, 3.0),
    rotors=(10.0, 8.0, 6.0, 0.3, 0.15),
    friction=(15.0, 12.0, 10.0, 1.5, 0.8),
    reach=(0.6, 0.5, 0.3, 1.8, 2.0),
    speed=(1.0, 1.0, 0.8, 3.0, 4.0),
    acceleration=(4.0, 4.0, 4.0, 14.0, 20.0),
    offset=(0.0, 0.0, 0.0, 0.0, 0.0),
    gravity=(0.0, 9.81, 0.0),
)
ARMS = {arm.name: arm for arm in (ARM7, GANTRY)}
UR5E = Arm(
    name="ur5e-like",
    rows=(
        ("revolute", 90.0, 0.0, 0.1625),
        ("revolute", 0.0, -0.425, 0.0),
        ("revolute", 0.0, -0.3922, 0.0),
        ("revolute", 90.0, 0.0, 0.1333),
        ("revolute", -90.0, 0.0, 0.0997),
        ("revolute", 0.0, 0.0, 0.0996),
    ),
    masses=(3.8, 8.1, 2.8, 1.4, 1.3, 0.4),
    rotors=(1.0, 1.0, 0.6, 0.15, 0.15, 0.15),
    friction=(6.0, 6.0, 4.0, 1.5, 1.5, 1.2),
    reach=(1.5, 1.0, 1.3, 1.5, 1.5, 2.0),
    speed=(2.0, 1.6, 2.0, 2.5, 2.5, 3.0),
    acceleration=(6.0, 5.0, 7.0, 10.0, 10.0, 12.0),
    offset=(0.0, -1.4, 1.2, -1.0, 1.0, 0.0),
)
IIWA14 = Arm(
    name="iiwa14-like",
    rows=(
        ("revolute", -90.0, 0.0, 0.36),
        ("revolute", 90.0, 0.0, 0.0),
        ("revolute", 90.0, 0.0, 0.42),
        ("revolute", -90.0, 0.0, 0.0),
        ("revolute", -90.0, 0.0, 0.40),
        ("revolute", 90.0, 0.0, 0.0),
        ("revolute", 0.0, 0.0, 0.126),
    ),
    masses=(5.8, 6.3, 3.5, 3.5, 3.3, 2.4, 0.4),
    rotors=(1.2, 1.2, 0.8, 0.8, 0.4, 0.3, 0.2),
    friction=(4.0, 4.0, 3.0, 3.0, 1.5, 1.0, 0.6),
    reach=(1.3, 1.0, 1.3, 1.0, 1.3, 1.1, 1.6),
    speed=(1.4, 1.4, 1.6, 1.3, 2.0, 2.2, 2.3),
    acceleration=(5.0, 5.0, 6.0, 6.0, 9.0, 10.0, 12.0),
    offset=(0.0, 0.4, 0.0, -1.1, 0.0, 0.9, 0.0),
)
TX40 = Arm(
    name="tx40-like",
    rows=(
        ("revolute", -90.0, 0.0, 0.32),
        ("revolute", 0.0, 0.225, 0.035),
        ("revolute", 90.0, 0.0, 0.0),
        ("revolute", -90.0, 0.0, 0.225),
        ("revolute", 90.0, 0.0, 0.0),
        ("revolute", 0.0, 0.0, 0.065),
    ),
    masses=(5.0, 4.5, 3.0, 1.8, 0.8, 0.15),
    rotors=(0.38, 0.38, 0.11, 0.03, 0.03, 0.01),
    friction=(7.0, 7.5, 6.5, 2.3, 2.9, 1.6),
    reach=(1.5, 1.2, 1.2, 2.0, 1.5, 2.5),
    speed=(4.0, 3.5, 4.5, 6.5, 6.0, 9.0),
    acceleration=(22.0, 20.0, 28.0, 50.0, 45.0, 75.0),
    offset=(0.0, -0.6, 1.2, 0.0, 0.5, 0.0),
)
PLANAR2 = Arm(
    name="planar2-like",
    rows=(("revolute", 0.0, 0.45, 0.0), ("revolute", 0.0, 0.4, 0.0)),
    masses=(3.0, 2.0),
    rotors=(0.15, 0.05),
    friction=(1.2, 0.6),
    reach=(1.6, 2.0),
    speed=(5.0, 7.0),
    acceleration=(25.0, 45.0),
    offset=(0.0, 0.0),
    gravity=(0.0, -9.81, 0.0),
)
INDEPENDENT = {arm.name: arm for arm in (UR5E, IIWA14, TX40, PLANAR2)}
"""Arms that no threshold was chosen on: geometry of four packaged robots, bodies of their size; the last two are light and fast."""
FREQUENCIES_HZ = 6.0
"""Natural frequency of the controllers: loose enough that tracking errors show the gains."""


def experiment(arm: Arm, *, seed: int = 0, rate_hz: float = 250.0, duration_s: float = 12.0) -> Experiment:
    """Experiment of an arm, its motion by a seed, without a log."""
    robot = arm.load()
    reference = Reference.random_fourier(
        harmonics=10,
        period_s=duration_s,
        max_position=arm.reach,
        max_velocity=arm.speed,
        max_acceleration=arm.acceleration,
        offset=arm.offset,
        seed=seed,
    )
    x = arm.truth(robot)
    q, _, _ = reference.at(np.linspace(0.0, duration_s, 200))
    inertia = np.mean([np.diag(m) for m in didim.inertia_matrix(robot, q, x)], axis=0)
    controller = Controller.tuned([FREQUENCIES_HZ] * robot.n_dof, [0.8] * robot.n_dof, inertia)
    factor = round(rate_hz / 25.0)
    prismatic = tuple(0.005 if row[0] == "prismatic" else 0.02 for row in arm.rows)
    return Experiment(
        name=arm.name,
        robot=robot,
        recordings=(),
        reference=reference,
        controller=controller,
        signal=SignalProcessing(
            cutoff_hz=min(40.0, 0.3 * rate_hz), trim_start=factor, trim_end=factor, decimation=_stages(factor)
        ),
        simulation=SimulationSettings(
            rate_hz=rate_hz, smoothing=prismatic, step_s=1e-3, fine_step_s=2.5e-4, start="reference"
        ),
    )


def _stages(factor: int) -> tuple[int, ...]:
    return (factor,) if factor <= 10 else (factor // 8, 8) if factor % 8 == 0 else (factor // 5, 5)


@dataclass(frozen=True, eq=False)
class Log:
    """A simulated log: the true experiment and its recording with a reference, without noise."""

    arm: Arm
    experiment: Experiment

    @classmethod
    def of(cls, arm: Arm, settings: Experiment, **truth: Any) -> Log:
        """Simulate; `truth` may hold `x`, a function of the true parameters, `robot` or `controller`."""
        robot = truth.get("robot", settings.robot)
        controller = truth.get("controller", settings.controller)
        x = truth["x"](robot, arm.truth(robot)) if "x" in truth else arm.truth(robot)
        made = simulated_log(
            replace(settings, robot=robot, controller=controller), x, noise=False, refinement=1
        )
        (recording,) = made.recordings
        reference = settings.reference
        assert isinstance(reference, Reference)
        recording = replace(recording, q_ref=reference.at(recording.t)[0], name=f"{arm.name} log")
        return cls(
            arm,
            replace(
                made,
                robot=settings.simulation.robot(settings.robot),
                controller=settings.controller,
                recordings=(recording,),
                reference=ReferenceSpec("recorded", None, {}),
            ),
        )

    def noisy(self, seed: int, level: float = 0.01, correlation: float = 0.0) -> Experiment:
        """The log with noise of a share of the rms torque, white or AR(1), and of the encoders."""
        (recording,) = self.experiment.recordings
        assert recording.tau is not None
        rng = np.random.default_rng(1000 + seed)
        noise = rng.standard_normal(recording.tau.shape)
        for k in range(1, len(noise) if correlation else 0):
            noise[k] = correlation * noise[k - 1] + np.sqrt(1.0 - correlation**2) * noise[k]
        size = level * np.std(recording.tau, axis=0)
        q = recording.q + 2e-6 * rng.standard_normal(recording.q.shape)
        return replace(
            self.experiment, recordings=(replace(recording, q=q, tau=recording.tau + size * noise),)
        )


@dataclass(frozen=True)
class Fault:
    """A fault: how it is planted, and the codes of reasons that name it."""

    name: str
    codes: tuple[str, ...]
    method: str = "idim-ls"
    truth: Callable[[Arm, Experiment], dict[str, Any]] | None = None
    plant: Callable[[Arm, Experiment], Experiment] = field(default=lambda arm, experiment: experiment)
    correlation: float = 0.0
    arms: tuple[str, ...] = ("arm7", "gantry")
    joints: tuple[int, ...] = ()


def _robot(**changes: Any) -> Callable[[Arm, Experiment], Experiment]:
    def plant(arm: Arm, experiment: Experiment) -> Experiment:
        robot = experiment.simulation.robot(arm.load(**changes))
        return replace(experiment, robot=robot)

    return plant


def _recording(
    change: Callable[[Array, Array, Array], tuple[Array, Array, Array]],
) -> Callable[[Arm, Experiment], Experiment]:
    def plant(arm: Arm, experiment: Experiment) -> Experiment:
        (recording,) = experiment.recordings
        assert recording.tau is not None
        assert recording.q_ref is not None
        q, tau, q_ref = change(recording.q.copy(), recording.tau.copy(), recording.q_ref.copy())
        return replace(experiment, recordings=(replace(recording, q=q, tau=tau, q_ref=q_ref),))

    return plant


def _late(values: Array, samples: int) -> Array:
    return np.concatenate([np.repeat(values[:1], samples, axis=0), values[:-samples]])


def _gain(joint: int, factor: float) -> Callable[[Arm, Experiment], Experiment]:
    def change(q: Array, tau: Array, q_ref: Array) -> tuple[Array, Array, Array]:
        tau[:, joint] *= factor
        return q, tau, q_ref

    return _recording(change)


def _controller(change: Callable[[Controller], Controller]) -> Callable[[Arm, Experiment], Experiment]:
    def plant(arm: Arm, experiment: Experiment) -> Experiment:
        assert isinstance(experiment.controller, Controller)
        return replace(experiment, controller=change(experiment.controller))

    return plant


def _stiffer(share: float) -> Callable[[Controller], Controller]:
    def change(controller: Controller) -> Controller:
        laws = controller.laws.copy()
        laws[:, 0] *= share
        return replace(controller, laws=laws)

    return change


def _turned(index: int) -> tuple[float, float, float]:
    directions = ((9.81, 0, 0), (-9.81, 0, 0), (0, 9.81, 0), (0, -9.81, 0), (0, 0, 9.81), (0, 0, -9.81))
    return tuple(float(value) for value in directions[index])  # type: ignore[return-value]


def _longer(arm: Arm, factor: float) -> tuple[tuple[str, float, float, float], ...]:
    """Rows with another length between two revolute joints: the longest one, for the first and the last move nothing beyond."""
    inner = range(1, len(arm.rows) - 1) if len(arm.rows) > 2 else range(1)
    places = [(row, place) for row in inner for place in (2, 3) if arm.rows[row][0] == "revolute"]
    row, place = max(places, key=lambda at: abs(arm.rows[at[0]][at[1]]))  # type: ignore[arg-type]
    changed = list(arm.rows[row])
    changed[place] = factor * arm.rows[row][place]  # type: ignore[operator]
    return (*arm.rows[:row], tuple(changed), *arm.rows[row + 1 :])  # type: ignore[arg-type]


def _asymmetric(arm: Arm, experiment: Experiment) -> dict[str, Any]:
    robot = experiment.robot.with_friction(model="asymmetric")

    def x(robot: Robot, truth: Array) -> Array:
        values = dict(zip(experiment.robot.parameter_names, arm.truth(experiment.robot), strict=True))
        for j in range(robot.n_dof):
            for key in ("Fv", "Fc"):
                value = values.pop(f"{key}{j + 1}")
                values[f"{key}{j + 1}+"], values[f"{key}{j + 1}-"] = 1.25 * value, 0.75 * value
        return np.array([values.get(name, 0.0) for name in robot.parameter_names])

    return {"robot": robot, "x": x}


def _stribeck(arm: Arm, experiment: Experiment) -> dict[str, Any]:
    terms = [
        didim.FrictionTerm(law="stribeck", joint=j, velocity=0.1 * arm.speed[j])
        for j in range(experiment.robot.n_dof)
    ]
    robot = experiment.robot.with_terms(terms)
    plain = experiment.robot.parameter_names

    def x(robot: Robot, truth: Array) -> Array:
        values = dict(zip(plain, arm.truth(experiment.robot), strict=True))
        extra = [name for name in robot.parameter_names if name not in values]
        values |= {name: 0.6 * arm.friction[j] for j, name in enumerate(extra)}
        return np.array([values[name] for name in robot.parameter_names])

    return {"robot": robot, "x": x}


def _saturated(arm: Arm, experiment: Experiment) -> dict[str, Any]:
    assert isinstance(experiment.controller, Controller)
    free = Log.of(arm, experiment).experiment.recordings[0].tau
    assert free is not None
    limit = 0.75 * np.abs(free).max(axis=0)
    return {"controller": replace(experiment.controller, saturation=limit)}


def _delayed(arm: Arm, experiment: Experiment) -> dict[str, Any]:
    assert isinstance(experiment.controller, Controller)
    from didim.loop.controller import Digital

    return {
        "controller": replace(experiment.controller, digital=Digital(sample_time_s=0.004, delay_samples=2))
    }


def _fed_forward(arm: Arm, experiment: Experiment) -> dict[str, Any]:
    assert isinstance(experiment.controller, Controller)
    reference = experiment.reference
    assert isinstance(reference, Reference)
    t = np.arange(0.0, reference.duration, 0.004)
    robot = experiment.simulation.robot(experiment.robot)
    tau = didim.inverse_dynamics(robot, *reference.at(t), arm.truth(robot))
    return {"controller": experiment.controller.with_feedforward(0.9 * tau, rate_hz=250.0)}


def faults(arm: Arm) -> list[Fault]:
    """Faults that an arm can have, with the codes that name them."""
    found: list[Fault] = []
    n = len(arm.rows)
    own = [k for k in range(6) if np.allclose(_turned(k), arm.gravity)]
    found += [
        Fault(f"gravity {_turned(k)}", ("gravity",), plant=_robot(gravity=_turned(k)))
        for k in range(6)
        if k not in own
    ]
    found.append(Fault("other DH convention", ("dh-convention",), plant=_robot(convention="mdh")))
    swapped = tuple((kind, alpha, d, a) for kind, alpha, a, d in arm.rows)
    found.append(Fault("a and d exchanged", ("a-and-d",), plant=_robot(rows=swapped)))
    found.append(Fault("a length 20 % off", ("link-length",), plant=_robot(rows=_longer(arm, 1.2))))
    for factor in (1.25, 2.0):
        found += [
            Fault(f"torque {j + 1} x {factor}", ("drive-gain",), plant=_gain(j, factor), joints=(j + 1,))
            for j in range(n)
        ]
    found.append(Fault(f"sign of torque {n}", ("torque-sign",), plant=_gain(n - 1, -1.0), joints=(n,)))
    found += [
        Fault("kp 10 % off", ("controller-gain",), "didim", plant=_controller(_stiffer(0.9))),
        Fault("kp 36 % off", ("controller-gain",), "didim", plant=_controller(_stiffer(0.64))),
        Fault("undeclared delay", ("controller-delay",), "didim", truth=_delayed),
        Fault("undeclared saturation", ("saturation",), "didim", truth=_saturated),
        Fault("missing feed-forward", ("feed-forward",), "didim", truth=_fed_forward),
        Fault(
            "reference 20 ms late",
            ("reference-late",),
            "didim",
            plant=_recording(lambda q, tau, q_ref: (q, tau, _late(q_ref, 5))),
        ),
        Fault("asymmetric friction", ("friction",), truth=_asymmetric),
        Fault("Stribeck friction", ("friction",), truth=_stribeck),
        Fault(
            "torque one sample late",
            ("delay",),
            plant=_recording(lambda q, tau, q_ref: (q, _late(tau, 1), q_ref)),
        ),
        Fault("AR(1) 0.95 noise", ("not-white",), correlation=0.95),
    ]
    return found


def obeyed(
    experiment: Experiment, method: didim.IDIMLS, remedy: Remedy
) -> tuple[Experiment, didim.IDIMLS] | None:
    """Return an experiment and its method after the edit that a finding asks for.

    None for an edit of units and axes, which no fault of these arms calls for: a finding that asks for one is misnamed.
    """
    (recording,) = experiment.recordings
    assert recording.tau is not None
    robot, at = experiment.robot, [joint - 1 for joint in remedy.joints]
    tau, q = recording.tau.copy(), recording.q.copy()
    value: Any = remedy.value
    geometry = robot.geometry
    if remedy.table == "[recording.torque]" and remedy.key in ("sign", "scale"):
        tau[:, at or slice(None)] /= -1.0 if remedy.action == "turn" else value
    elif (remedy.table, remedy.key) == ("[recording.torque]", "columns"):
        tau[:, at] = tau[:, at[::-1]]
    elif (remedy.table, remedy.key) == ("[recording.position]", "columns"):
        q[:, at] = q[:, at[::-1]]
    elif remedy.key == "gravity_m_s2":
        robot = with_geometry(robot, gravity=tuple(value))
    elif remedy.key == "convention":
        robot = of_other_convention(robot)
    elif remedy.key == "alpha_deg":
        before = robot.standard is not None  # a standard row has the twist of the next one
        alpha = [-a if joint - before in at else a for joint, a in enumerate(geometry.alpha)]
        robot = with_geometry(robot, alpha=tuple(alpha))
    elif remedy.table == "[[joint]]" and remedy.action == "set":
        # a (d) of a standard (modified) row are d of the geometry, along the other axis r
        key = "d" if remedy.key == ("a_m" if robot.standard is not None else "d_m") else "r"
        before = robot.standard is not None and key == "d"
        values = [value if joint - before in at else own for joint, own in enumerate(getattr(geometry, key))]
        robot = with_geometry(robot, **{key: tuple(values)})
    elif (remedy.table, remedy.key) == ("[friction]", "model"):
        robot = robot.with_friction(model=value)
    elif (remedy.table, remedy.key) == ("[friction]", "terms"):
        method = replace(method, friction=value)
    elif (remedy.table, remedy.key) == ("[delay]", "compensate_samples"):
        method = replace(method, compensate_samples=value)
    else:
        return None
    return replace(experiment, robot=robot, recordings=(replace(recording, q=q, tau=tau),)), method


def expected_error(fit: didim.Identification) -> float:
    """Share of the torques that a result misses on blocks that were left out."""
    (control,) = [use for use in fit.verdict.uses if use.name == "control"]
    assert control.error is not None
    return control.error


def built(arm: Arm, fault: Fault | None, *, motion: int = 0, rate_hz: float = 250.0) -> Log:
    """The log of an arm with the truth that a fault wants."""
    settings = experiment(arm, seed=motion, rate_hz=rate_hz)
    return Log.of(
        arm, settings, **({} if fault is None or fault.truth is None else fault.truth(arm, settings))
    )


def planted(log: Log, fault: Fault | None, seed: int, level: float = 0.01) -> Experiment:
    """A log with noise of a seed, and a fault planted."""
    if fault is None:
        return log.noisy(seed, level)
    return fault.plant(
        log.arm, log.noisy(seed, 3.0 * level if fault.correlation else level, fault.correlation)
    )


def laws(log: Log) -> Array:
    """Gains of a log's controller."""
    return closed_loop(log.experiment, log.experiment.recordings[0]).controller.laws
