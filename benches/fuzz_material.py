"""Sound files that `fuzz.py` mutates: robots, logs, experiments, results and a checkpoint, all small and fast.

`fuzz_readers.py` has those of the other readers. A scenario is a command line with the files that it reads; each
must end well before it is mutated.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import fuzz_readers
import numpy as np
from numpy.typing import NDArray

import didim
from didim.cli.main import main
from didim.robot.robot_file import PACKAGED

Array = NDArray[np.float64]

RATE_HZ = 250.0

ARM = "[friction]\ncoulomb = 'tanh'\nsmoothing_rad_s = 0.05\ndead_zone_rad_s = 0.0\nmodel = 'symmetric'\n"

# One prismatic joint, the smallest robot for the methods that simulate.
SLIDE = """\
schema = 1
name = "slide"
description = "one prismatic joint"
gravity_m_s2 = [0.0, 0.0, 0.0]
[[joint]]
kind = "prismatic"
alpha_deg = 0.0
d_m = 0.0
theta_deg = 0.0
r_m = 0.0
limits = { position_m = [-1.0, 1.0], velocity_m_s = 3.0, force_n = 500.0 }
[transmission]
coupling = [[1.0]]
reduction = [[50.0]]
drive_gains = [35.0]
[friction]
coulomb = "tanh"
smoothing_m_s = 0.05
[parameters.reference]
Ia1 = 2.0
Fv1 = 5.0
Fc1 = 3.0
Off1 = 0.5
[parameters.apriori]
Ia1 = 1.5
"""

LOG = """\
schema = 1
robot = "arm.toml"
name = "log"
[friction]
model = "symmetric"
coulomb = "tanh"
coupling = "shaft"
smoothing_rad_s = [0.05, 0.05]
[[recording]]
name = "first"
role = "fit"
rate_hz = 250
windows_s = [[0.0, 0.9]]
[recording.time]
file = "log.csv"
columns = ["t"]
unit = "s"
[recording.position]
file = "log.csv"
columns = ["q1", "q2"]
unit = "rad"
side = "joint"
[recording.torque]
file = "log.csv"
columns = ["tau1", "tau2"]
unit = "N.m"
side = "joint"
[signal]
cutoff_hz = 40.0
order = 4
padding = "scipy"
form = "sections"
trim_start = 5
trim_end = 5
decimation = [2]
decimation_convention = "scipy"
edge_rows = 1
[least_squares]
weights = "per-joint"
reweightings = 1
variance = "r-b"
uncertainty = "decimated"
[delay]
compensate_samples = 0.5
[parameters]
dropped = ["Off2"]
[parameters.fixed]
Fv1 = 1.2
"""

MOTOR = """\
schema = 1
robot = "arm.toml"
[transmission]
reduction = [[10.0, 0.0], [1.0, 8.0]]
[[recording]]
name = "motors"
rate_hz = 250.0
[recording.position]
file = "log.FORMAT"
variable = "counts"
unit = "count"
counts_per_rev = 4096
side = "motor"
[recording.torque]
file = "log.FORMAT"
variable = "current"
columns = [1, 2]
unit = "A"
gain = [0.5, 0.25]
side = "motor"
[recording.reference]
file = "log.FORMAT"
columns = ["r1", "r2"]
unit = "deg"
side = "joint"
[signal]
cutoff_hz = 40.0
form = "transfer-function"
padding = "matlab"
decimation = [2, 2]
decimation_convention = "matlab"
[delay]
compensate_samples = "estimate"
"""

PLAIN = """\
schema = 1
robot = "arm.toml"
[[recording]]
[recording.time]
file = "plain.txt"
delimiter = " "
header = false
columns = [1]
unit = "ms"
[recording.position]
file = "plain.txt"
delimiter = " "
header = false
columns = [2, 3]
unit = "deg"
side = "joint"
[recording.torque]
file = "plain.txt"
delimiter = " "
header = false
columns = [4, 5]
unit = "N.m"
side = "joint"
"""

RECORDED = """\
[[recording]]
rate_hz = 250
[recording.position]
file = "log.csv"
columns = ["q1", "q2"]
unit = "rad"
side = "joint"
[recording.torque]
file = "log.csv"
columns = ["tau1", "tau2"]
unit = "N.m"
side = "joint"
[recording.reference]
file = "log.csv"
columns = ["r1", "r2"]
unit = "rad"
side = "joint"
[signal]
cutoff_hz = 40.0
decimation = [2]
"""

FOLLOWED = """\
schema = 1
robot = "arm.toml"
name = "followed"
[reference]
kind = "recorded"
[controller]
kind = "pid"
kp = [2000.0, 800.0]
kv = [60.0, 20.0]
ki = [100.0, 50.0]
gain = [1.0, 1.0]
reference_velocity = 1.0
acceleration = [0.1, 0.1]
saturation_n_m = [200.0, 100.0]
[simulation]
step_s = 0.002
fine_step_s = [0.001, 0.001]
divergence = 10.0
start = "reference"
smoothing_rad_s = 0.05
[measurement]
encoder_resolution_rad = 1e-6
position_noise_rad = 1e-6
torque_noise_n_m = [0.1, 0.1]
seed = 1
"""

FOURIER = """\
schema = 1
robot = "arm.toml"
[reference]
kind = "fourier"
period_s = 0.5
duration_s = 1.0
harmonics = 5
seed = 3
offset_deg = [10.0, 20.0]
max_position_rad = [0.5, 0.5]
max_velocity_rad_s = 3.0
max_acceleration_rad_s2 = [30.0, 30.0]
[controller]
kind = "pd"
natural_frequency_hz = [6, 6]
damping = 0.7
inertia_of = "reference"
feedforward_of = "reference"
sample_time_s = 0.004
delay_samples = 1
velocity_fir = [0.5, 0.5]
encoder_resolution_rad = 1e-5
[simulation]
rate_hz = 250
duration_s = 1.0
step_s = 0.002
fine_step_s = 0.001
smoothing_rad_s = [0.05, 0.05]
"""

SINES = """\
schema = 1
robot = "arm.toml"
[reference]
kind = "fourier"
period_s = 1.0
offset_rad = 0.1
sine_deg = [[10.0, 5.0], [3.0, -4.0]]
cosine_deg = [[1.0, 2.0], [0.5, 0.5]]
[controller]
kind = "pd"
natural_frequency_hz = 12
damping = [0.7, 0.7]
inertia = [1.0, 0.2]
[simulation]
rate_hz = 250
step_s = 0.002
fine_step_s = 0.002
smoothing_rad_s = 0.1
"""

POINTS = """\
schema = 1
robot = "arm.toml"
[reference]
kind = "point-to-point"
points_deg = [[0, 0], [20, -30], [5, 10]]
max_velocity_deg_s = [100, 150]
max_acceleration_deg_s2 = 500
dwell_s = 0.05
[controller]
kind = "cascade"
kp = [30.0, 30.0]
kv = [20.0, 8.0]
integral_time_s = 0.1
saturation_v = 100.0
[simulation]
rate_hz = 250
step_s = 0.002
fine_step_s = 0.002
smoothing_rad_s = 0.05
"""

SLIDING = """\
schema = 1
robot = "slide.toml"
name = "sliding"
[reference]
kind = "fourier"
period_s = 0.5
duration_s = 0.6
harmonics = 4
seed = 2
max_position_mm = 300
max_velocity_m_s = 2.0
max_acceleration_m_s2 = 40.0
[controller]
kind = "pd"
natural_frequency_hz = 15
damping = 0.7
inertia_of = "reference"
[simulation]
rate_hz = 250
step_s = 0.002
fine_step_s = 0.002
smoothing_m_s = 0.05
"""

SLID = """\
[[recording]]
rate_hz = 250
[recording.position]
file = "slide.csv"
columns = ["q1"]
unit = "m"
side = "joint"
[recording.torque]
file = "slide.csv"
columns = ["tau1"]
unit = "N"
side = "joint"
[signal]
cutoff_hz = 40.0
decimation = [2]
"""

CLOE = ["identify", "sliding.toml", "--method", "cloe"]


@dataclass(frozen=True)
class Scenario:
    """A command, and the files that it reads and writes."""

    arguments: tuple[str, ...]
    files: tuple[str, ...]
    weight: int = 1


def _scenario(arguments: Sequence[str], files: str, weight: int = 1) -> Scenario:
    return Scenario(tuple(arguments), tuple(files.split()), weight)


SCENARIOS = (
    _scenario(["identify", "log.toml", "--json", "out.json"], "log.toml arm.toml log.csv", 12),
    _scenario(["identify", "npz.toml", "--verbose"], "npz.toml arm.toml log.npz", 4),
    _scenario(["identify", "mat.toml", "--quiet", "--json", "out.json"], "mat.toml arm.toml log.mat", 4),
    _scenario(["identify", "plain.toml"], "plain.toml arm.toml plain.txt", 4),
    _scenario(
        ["identify", "sliding.toml", "--method", "didim", "--json", "out.json"],
        "sliding.toml slide.toml slide.csv",
        3,
    ),
    _scenario(
        ["identify", "sliding.toml", "--method", "didim", "--start", "idim-ls"],
        "sliding.toml slide.toml slide.csv",
    ),
    _scenario([*CLOE, "--json", "out.json"], "sliding.toml slide.toml slide.csv"),
    _scenario([*CLOE, "--output", "both", "--start", "reference"], "sliding.toml slide.toml slide.csv"),
    _scenario([*CLOE, "--checkpoint", "search.npz"], "search.npz sliding.toml slide.toml slide.csv", 2),
    _scenario(
        [*CLOE, "--optimizer", "nelder-mead", "--start", "reference", "--checkpoint", "simplex.npz"],
        "simplex.npz",
        1,
    ),
    _scenario(["validate", "fit.json", "log.toml", "--json", "out.json"], "fit.json log.toml log.csv", 4),
    _scenario(["validate", "fit.json", "followed.toml"], "fit.json followed.toml arm.toml log.csv", 4),
    _scenario(
        ["simulate", "followed.toml", "--parameters", "fit.json"], "followed.toml fit.json arm.toml", 4
    ),
    _scenario(
        ["simulate", "fourier.toml", "--parameters", "reference", "-o", "out.csv"], "fourier.toml arm.toml", 4
    ),
    _scenario(["simulate", "sines.toml", "--parameters", "reference"], "sines.toml arm.toml", 3),
    _scenario(["simulate", "points.toml", "--parameters", "reference"], "points.toml arm.toml", 3),
    _scenario(["simulate", "sliding.toml", "--parameters", "reference"], "sliding.toml slide.toml", 2),
    _scenario(
        [
            "compare",
            "--experiment",
            "loop.toml",
            "--parameters",
            "reference",
            "--nelder-mead",
            "none",
            "--quiet",
        ],
        "loop.toml slide.toml",
    ),
    _scenario(["simulate", "followed.toml", "--parameters", "found.toml"], "found.toml", 2),
    _scenario(["simulate", "followed.toml", "--parameters", "found.npz"], "found.npz", 3),
    _scenario(["check", "followed.toml", "--parameters", "found.npz"], "found.npz"),
    _scenario(["base", "arm.toml"], "arm.toml", 3),
    _scenario(["base", "slide.toml"], "slide.toml"),
    _scenario(["check", "log.toml", "--json", "out.json"], "log.toml arm.toml log.csv", 2),
    _scenario(["check", "npz.toml"], "npz.toml log.npz"),
    _scenario(["check", "followed.toml", "--parameters", "fit.json"], "followed.toml fit.json log.csv"),
    _scenario(["init", "arm.toml", "log.csv", "-o", "out.toml", "--force"], "log.csv arm.toml", 3),
    _scenario(
        ["init", "arm.toml", "plain.txt", "-o", "out.toml", "--force", "--rate", "250"], "plain.txt", 2
    ),
    *(_scenario(*row) for row in fuzz_readers.SCENARIOS),
    *(_scenario(*row) for row in fuzz_readers.BAGS if fuzz_readers.has_bags()),
)


def make(folder: Path) -> None:
    """Write every file of the scenarios into a folder.

    Parameters
    ----------
    folder : Path
        An empty folder; it becomes the working folder of the process.
    """
    packaged = (PACKAGED / "planar2.toml").read_text(encoding="utf-8")
    sets = packaged.index("[parameters")
    texts = {
        "arm.toml": packaged[:sets] + ARM + packaged[sets:],
        "slide.toml": SLIDE,
        "log.toml": LOG,
        "npz.toml": MOTOR.replace("FORMAT", "npz"),
        "mat.toml": MOTOR.replace("FORMAT", "mat"),
        "plain.toml": PLAIN,
        "followed.toml": FOLLOWED + RECORDED,
        "fourier.toml": FOURIER,
        "sines.toml": SINES,
        "points.toml": POINTS,
        "loop.toml": SLIDING,
        "sliding.toml": SLIDING + SLID,
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    motion = _arm_logs(folder)
    _results()
    fuzz_readers.make(folder, motion)


def _arm_logs(folder: Path) -> tuple[Array, Array, Array, Array]:
    from scipy.io import savemat

    robot = didim.load_robot(folder / "arm.toml")
    t = np.arange(250) / RATE_HZ
    sine = np.array([[0.4, 0.3], [0.2, -0.3], [0.1, 0.15]])
    reference = didim.Reference.fourier(sine, 0.5 * sine[::-1], period_s=0.8, duration_s=t[-1])
    controller = didim.Controller.pid([2000.0, 800.0], [60.0, 20.0], [100.0, 50.0])
    run = didim.simulate(robot, robot.sets["reference"], reference, controller, rate_hz=RATE_HZ, step=5e-4)
    rng = np.random.default_rng(1)
    q = run.q + 1e-6 * rng.standard_normal(run.q.shape)
    tau = run.tau + 0.05 * rng.standard_normal(run.tau.shape)
    followed = reference.at(run.t)[0]
    _table(folder / "log.csv", "t,q1,q2,tau1,tau2,r1,r2", ",", run.t, q, tau, followed)
    _table(folder / "plain.txt", "", " ", 1000.0 * run.t, np.rad2deg(q), tau)
    reduction = np.array([[10.0, 0.0], [1.0, 8.0]])
    arrays = {
        "counts": np.round(q @ reduction.T * 4096 / (2.0 * np.pi)),
        "current": tau @ np.linalg.inv(reduction) / np.array([0.5, 0.25]),
        "r1": np.rad2deg(followed[:, 0]),
        "r2": np.rad2deg(followed[:, 1]),
    }
    np.savez(folder / "log.npz", **arrays)
    savemat(folder / "log.mat", arrays)
    return run.t, q, run.dq, tau


def _results() -> None:
    """The log of the slide, a result of IDIM-LS with its parameter files, and checkpoints of both searches of CLOE."""
    silence = io.StringIO()
    with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
        main(["simulate", "loop.toml", "--parameters", "reference", "-o", "slide.csv"])
        main(["identify", "log.toml", "--json", "fit.json", "--save-parameters", "found.toml"])
        main(["identify", "log.toml", "--save-parameters", "found.npz"])
        main([*CLOE, "--checkpoint", "search.npz"])
        main([*CLOE, "--optimizer", "nelder-mead", "--start", "reference", "--checkpoint", "simplex.npz"])


def _table(path: Path, header: str, delimiter: str, *columns: Array) -> None:
    np.savetxt(path, np.column_stack(columns), fmt="%.12g", delimiter=delimiter, header=header, comments="")
