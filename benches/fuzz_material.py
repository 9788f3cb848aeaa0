"""Sound files that `fuzz.py` mutates, and the commands that read them: arms of two joints, one slide, all readers."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import didim
from didim.cli.main import main
from didim.robot.robot_file import PACKAGED

Array = NDArray[np.float64]

RATE_HZ = 250.0


def source(kind: str, file: str, unit: str, columns: str = "", *more: str, side: str = "joint") -> str:
    """Return the table of a recording that names a file, with more lines."""
    lines = [f"[recording.{kind}]", f'file = "{file}"', f'unit = "{unit}"', *more]
    if columns:
        lines.append(
            f"columns = {json.dumps([int(name) if name.isdigit() else name for name in columns.split()])}"
        )
    if kind != "time":
        lines.append(f'side = "{side}"')
    return "\n".join(lines) + "\n"


ARM = "[friction]\ncoulomb = 'tanh'\nsmoothing_rad_s = 0.05\ndead_zone_rad_s = 0.0\nmodel = 'symmetric'\n"
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
LOG = f"""\
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
{source("time", "log.csv", "s", "t")}\
{source("position", "log.csv", "rad", "q1 q2")}\
{source("torque", "log.csv", "N.m", "tau1 tau2")}\
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
MOTOR = f"""\
schema = 1
robot = "arm.toml"
[transmission]
reduction = [[10.0, 0.0], [1.0, 8.0]]
[[recording]]
name = "motors"
rate_hz = 250.0
{source("position", "log.FORMAT", "count", "", 'variable = "counts"', "counts_per_rev = 4096", side="motor")}\
{source("torque", "log.FORMAT", "A", "1 2", 'variable = "current"', "gain = [0.5, 0.25]", side="motor")}\
{source("reference", "log.FORMAT", "deg", "r1 r2")}\
[signal]
cutoff_hz = 40.0
form = "transfer-function"
padding = "matlab"
decimation = [2, 2]
decimation_convention = "matlab"
[delay]
compensate_samples = "estimate"
"""
PLAIN = f"""\
schema = 1
robot = "arm.toml"
[[recording]]
{source("time", "plain.txt", "ms", "1", 'delimiter = " "', "header = false")}\
{source("position", "plain.txt", "deg", "2 3", 'delimiter = " "', "header = false")}\
{source("torque", "plain.txt", "N.m", "4 5", 'delimiter = " "', "header = false")}"""
RECORDED = f"""\
[[recording]]
rate_hz = 250
{source("position", "log.csv", "rad", "q1 q2")}\
{source("torque", "log.csv", "N.m", "tau1 tau2")}\
{source("reference", "log.csv", "rad", "r1 r2")}\
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
SLID = f"""\
[[recording]]
rate_hz = 250
{source("position", "slide.csv", "m", "q1")}\
{source("torque", "slide.csv", "N", "tau1")}\
[signal]
cutoff_hz = 40.0
decimation = [2]
"""
URDF = """\
<?xml version="1.0"?>
<robot name="two">
  <link name="base"/>
  <link name="upper">
    <inertial><origin xyz="0.25 0 0.01" rpy="0 0 0.1"/><mass value="3.0"/>
      <inertia ixx="0.02" ixy="0.001" ixz="0.0" iyy="0.1" iyz="0.0" izz="0.11"/></inertial>
  </link>
  <link name="fore">
    <inertial><origin xyz="0.2 0 0"/><mass value="1.5"/>
      <inertia ixx="0.01" ixy="0.0" ixz="0.0" iyy="0.04" iyz="0.0" izz="0.045"/></inertial>
  </link>
  <link name="tool">
    <inertial><origin xyz="0 0 0.02"/><mass value="0.3"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial>
  </link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.1" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" velocity="3.0" effort="80"/><dynamics damping="0.5" friction="0.4"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/><limit velocity="4.0" effort="30"/></joint>
  <joint name="mount" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0.4 0 0" rpy="0 0 0.3"/></joint>
</robot>
"""
STUDY = """\
schema = 1
name = "small"
experiment = "loop.toml"
parameters = "reference"
refinement = 1
[repeat]
seeds = 2
root = 7
[[method]]
name = "idim-ls"
label = "filtered"
"signal.cutoff_hz" = 20
[[method]]
name = "didim"
physical = false
start = { spread = 0.15 }
seeds = 1
[grid]
"measurement.torque_noise_n" = [[0.1], [0.5]]
"simulation.rate_hz" = [250]
[[scenario]]
name = "low gains"
"model.controller.natural_frequency_hz" = 14
"""
EXCITE = """\
schema = 1
[excitation]
kind = "fourier"
duration_s = 1.0
harmonics = 4
periods = 2
rate_hz = 100
log_rate_hz = 50
seed = 1
starts = 1
iterations = 2
threads = 1
margin = 0.9
torque_noise_n = [0.5]
parameters = "reference"
home_m = [0.0]
criterion = "information"
smoothing_rad_s = 0.05
[limits]
position_m = [[-0.8, 0.8]]
max_velocity_m_s = 2.0
max_acceleration_m_s2 = [20.0]
max_jerk_m_s3 = [500.0]
max_torque_n = [300.0]
"""
CLEAR = """\
schema = 1
[excitation]
duration_s = 1.0
harmonics = 4
rate_hz = 100
starts = 1
iterations = 1
threads = 1
torque_noise_n_m = [0.5, 0.2]
parameters = "reference"
prior = ["fit.json"]
for = ["ZZ1R"]
[limits]
max_acceleration_rad_s2 = [20, 30]
max_torque_n_m = [100.0, 50.0]
[workspace]
floor_m = -3.0
lowest_m = [-3, -3, -3]
highest_m = [3, 3, 3]
clearance_m = 0.01
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.05
[[collision]]
link = 0
from_m = [0, 0, -1]
to_m = [0, 0, -0.8]
radius_m = 0.06
[[collision]]
link = 2
from_m = [0, 0, 0]
to_m = [0.3, 0, 0]
radius_m = 0.05
"""
POINTED = """\
[excitation]
kind = "point-to-point"
points = 3
dwell_s = 0.1
rate_hz = 100
starts = 1
iterations = 1
threads = 1
"""
SIGNALS = f"""\
{source("position", "log.csv", "rad", "q1 q2")}\
{source("torque", "log.csv", "N.m", "tau1 tau2", "scale = [1.0, 1.0]", "sign = [1, 1]")}"""
LOADED = f"""\
schema = 1
robot = "arm.toml"
[payload.disc]
mass_kg = 0.5
com_m = [0.1, 0.0, 0.0]
inertia_kg_m2 = [0.01, 0.0, 0.0, 0.01, 0.0, 0.01]
[payload.other]
mass_kg = 1.0
[flange]
xyz_m = [0.4, 0.0, 0.0]
rpy_deg = [0.0, 0.0, 10.0]
[[recording]]
name = "free"
rate_hz = 250
{SIGNALS}
[[recording]]
name = "loaded"
payload = "disc"
offsets = "own"
friction = "own"
rate_hz = 250
windows_s = [[0.0, 0.4], [0.5, 0.9]]
{SIGNALS}
[[recording]]
name = "unknown"
payload = "other"
rate_hz = 250
{SIGNALS}
[signal]
cutoff_hz = 40.0
decimation = [2]
spikes = "hampel"
[least_squares]
uncertainty = "decimated"
blocks = 4
"""
WEIGHED = f"""\
schema = 1
robot = "arm.toml"
[payload.thing]
[[recording]]
payload = "thing"
offsets = "own"
rate_hz = 250
{SIGNALS}
[signal]
cutoff_hz = 40.0
"""
SEPARATED = SIGNALS.replace('"log.csv"', '"sensed.csv"\ndelimiter = ";"')
SENSED = f"""\
schema = 1
robot = "arm.toml"
[[recording]]
{source("time", "sensed.csv", "s", "t", 'delimiter = ";"', "resample = true")}\
{SEPARATED}
{source("velocity", "sensed.csv", "rad/s", "dq1 dq2", 'delimiter = ";"')}\
{source("external", "sensed.csv", "N.m", "e1 e2", 'delimiter = ";"')}\
[signal]
cutoff_hz = 40.0
ends = "second-order"
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.05
"""
BAG = f"""\
schema = 1
robot = "arm.urdf"
[[recording]]
[recording.time]
file = "run"
topic = "/joint_states"
resample = true
{source("position", "run", "rad", "", 'topic = "/joint_states"')}\
{source("torque", "run", "N.m", "shoulder elbow", 'topic = "/joint_states"')}\
[signal]
cutoff_hz = 40.0
"""
MJCF = """\
<mujoco model="arm">
  <compiler angle="degree" eulerseq="xyz" autolimits="true" inertiagrouprange="0 3" boundmass="0.01"/>
  <option gravity="0 0 -9.81" integrator="implicitfast"/>
  <default><joint damping="0.3" armature="0.02"/><geom density="700"/>
    <default class="arm"><joint axis="0 1 0" frictionloss="0.4" range="-90 45" solimpfriction="0.9 0.95"/></default></default>
  <asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/><mesh name="gone" file="gone.stl"/></asset>
  <worldbody>
    <frame pos="0.1 0 0.2" euler="20 0 0">
      <body name="a" pos="0 0 0.3" axisangle="0 1 0 25" childclass="arm">
        <joint name="shoulder"/><geom type="capsule" size="0.05 0.2" fromto="0 0 0 0.1 0 0"/>
        <body name="b" pos="0.3 0 0" xyaxes="0 1 0 -1 0 0">
          <joint name="elbow" pos="0.05 0 0" ref="40" stiffness="3" springref="10"/>
          <inertial pos="0 0 0.1" mass="0.7" fullinertia="0.01 0.012 0.014 0.001 -0.002 0.0005"/><geom type="mesh" mesh="gone"/>
          <body name="c" pos="0 0 0.2" gravcomp="1"><joint name="wrist" type="slide" axis="0 0 1" springdamper="0.1 1"/>
            <geom type="mesh" mesh="m" mass="0.2"/><replicate count="3" offset="0 0 0.1"><geom size="0.02"/></replicate></body>
        </body>
      </body>
    </frame>
  </worldbody>
  <tendon>
    <fixed name="t" armature="0.1" stiffness="2"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="2"/></fixed>
  </tendon>
  <equality>
    <joint joint1="wrist" joint2="elbow" polycoef="0.1 0.5 0 0 0"/><connect body1="c" body2="a" anchor="0 0 0"/>
  </equality>
  <actuator>
    <position joint="shoulder" kp="50" dampratio="1" forcerange="-7 7" gear="3"/>
    <general joint="elbow" gainprm="40" biastype="affine" biasprm="0 -40 -3" dyntype="filter" dynprm="0.02"/>
    <motor jointinparent="wrist" gear="10" ctrlrange="-3 3"/>
  </actuator>
  <keyframe><key qpos="0 0 0"/></keyframe>
</mujoco>
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


READERS: tuple[tuple[list[str], str, int], ...] = (
    (["study", "study.toml", "-o", "new.jsonl", "--executor", "serial", "--quiet"], "study.toml loop.toml slide.toml", 2),
    (["study", "study.toml", "-o", "rows.jsonl", "--executor", "serial", "--quiet"], "rows.jsonl", 2),
    (["study", "rows.jsonl", "--format", "csv"], "rows.jsonl", 3),
    (["excite", "slide.toml", "excite.toml", "-o", "motion.csv", "--quiet"], "excite.toml slide.toml", 4),
    (["excite", "arm.toml", "clear.toml", "-o", "motion.toml", "--quiet"], "clear.toml arm.toml fit.json", 3),
    (["excite", "slide.toml", "pointed.toml", "-o", "motion.yaml", "--quiet"], "pointed.toml", 1),
    (["identify", "loaded.toml", "--json", "out.json"], "loaded.toml loaded.toml arm.toml log.csv", 4),
    (["payload", "fit.json", "weighed.toml", "--json", "out.json"], "weighed.toml weighed.toml fit.json log.csv", 3),
    (["residual", "fit.json", "log.toml", "-o", "out.csv"], "fit.json log.toml log.csv", 2),
    (["residual", "fit.json", "known.toml"], "known.toml", 1),
    (["identify", "sensed.toml", "--json", "out.json"], "sensed.toml sensed.csv sensed.csv", 4),
    (["init", "arm.toml", "sensed.csv", "-o", "out.toml", "--force"], "sensed.csv", 2),
    (["identify", "hdf.toml", "--quiet", "--json", "out.json"], "hdf.toml log.h5 log.h5", 3),
    (["init", "arm.toml", "log.h5", "-o", "out.toml", "--force"], "log.h5", 1),
    (["init", "arm.toml", "log.npz", "-o", "out.toml", "--force"], "log.npz", 1),
    (["init", "arm.toml", "log.csv", "sensed.csv", "-o", "out.toml", "--force"], "sensed.csv log.csv", 1),
    (["robot", "arm.urdf", "-o", "out.toml", "--force"], "arm.urdf", 4),
    (["base", "arm.urdf"], "arm.urdf", 2),
    (["robot", "arm.xml", "-o", "out.toml", "--force"], "arm.xml", 6),
    (["export", "fit.json", "--mjcf", "-o", "out.txt"], "fit.json arm.toml", 2),
    (["export", "fit.json", "--sdf", "-o", "out.txt"], "fit.json", 1),
    (["export", "fit.json", "--c", "-o", "out.txt"], "fit.json", 1),
    (["export", "fit.json", "--latex", "-o", "out.txt"], "fit.json", 1),
    (["export", "--parameters", "urdf", "--robot", "arm.urdf", "--urdf", "arm.urdf", "-o", "out.urdf"], "arm.urdf", 2),
    (["identify", "sliding.toml", "--method", "idim-iv", "--json", "out.json"], "sliding.toml slide.csv", 2),
    (["identify", "log.toml", "--solver", "huber", "--uncertainty", "decimated"], "log.toml log.csv", 1),
    (["identify", "log.toml", "--physical", "--json", "out.json"], "log.toml arm.toml log.csv", 2),
    (["identify", "log.toml", "--format", "latex"], "log.csv", 1),
)  # fmt: skip
"""Arguments, files that are mutated, and how often."""
BAGS: tuple[tuple[list[str], str, int], ...] = (
    (["identify", "bag.toml", "--json", "out.json"], "bag.toml run/run.mcap run/run.mcap run/metadata.yaml", 3),
    (["init", "arm.urdf", "run", "-o", "out.toml", "--force"], "run/run.mcap run/metadata.yaml", 2),
)  # fmt: skip
"""The same of bags, for machines that have the extra 'ros'."""


def has_bags() -> bool:
    """Whether bags can be made here."""
    try:
        import rosbags  # noqa: F401
    except ImportError:
        return False
    return True


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
    *(_scenario(*row) for row in READERS),
    *(_scenario(*row) for row in BAGS if has_bags()),
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
    _readers(folder, motion)


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


def _readers(folder: Path, motion: tuple[Array, Array, Array, Array]) -> None:
    """Write the files of `READERS` beside the others; the motion is that of the arm: times, positions, velocities, torques."""
    texts = {
        "arm.urdf": URDF,
        "arm.xml": MJCF,
        "study.toml": STUDY,
        "excite.toml": EXCITE,
        "clear.toml": CLEAR,
        "pointed.toml": POINTED,
        "loaded.toml": LOADED,
        "weighed.toml": WEIGHED,
        "known.toml": WEIGHED.replace(
            "[payload.thing]",
            "[payload.thing]\nmass_kg = 0.2\ncom_m = [0.0, 0.0, 0.0]\ninertia_kg_m2 = [0.01, 0.0, 0.0, 0.01, 0.0, 0.01]",
        ).replace('offsets = "own"', ""),
        "sensed.toml": SENSED,
        "hdf.toml": (folder / "npz.toml").read_text(encoding="utf-8").replace(".npz", ".h5"),
        "bag.toml": BAG,
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    t, q, dq, tau = motion
    rng = np.random.default_rng(2)
    jittered = t + 1e-4 * rng.uniform(-1.0, 1.0, len(t))
    outside = 0.01 * rng.standard_normal(tau.shape)
    np.savetxt(
        folder / "sensed.csv",
        np.column_stack([jittered, q, dq, tau, outside]),
        fmt="%.12g",
        delimiter=";",
        header="t;q1;q2;dq1;dq2;tau1;tau2;e1;e2",
        comments="",
    )
    _hdf5(folder)
    if has_bags():
        sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
        from bags import write_bag

        write_bag(folder / "run", ["shoulder", "elbow"], t, q, tau, mcap=True)
    silence = io.StringIO()
    with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
        main(["study", "study.toml", "-o", "rows.jsonl", "--executor", "serial", "--quiet"])


def _hdf5(folder: Path) -> None:
    import h5py

    with np.load(folder / "log.npz") as arrays, h5py.File(folder / "log.h5", "w") as file:
        for name in arrays.files:
            file[name] = arrays[name]
