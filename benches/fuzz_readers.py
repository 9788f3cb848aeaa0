"""Sound files that `fuzz.py` mutates, of readers beside those of robots, logs and results: studies, designs, payloads, bags, URDF.

`fuzz_material.py` has the other ones.
"""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from didim.cli.main import main

Array = NDArray[np.float64]

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

SIGNALS = """\
[recording.position]
file = "log.csv"
columns = ["q1", "q2"]
unit = "rad"
side = "joint"
[recording.torque]
file = "log.csv"
columns = ["tau1", "tau2"]
unit = "N.m"
scale = [1.0, 1.0]
sign = [1, 1]
side = "joint"
"""

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
[recording.time]
file = "sensed.csv"
delimiter = ";"
columns = ["t"]
unit = "s"
resample = true
{SEPARATED}
[recording.velocity]
file = "sensed.csv"
delimiter = ";"
columns = ["dq1", "dq2"]
unit = "rad/s"
side = "joint"
[recording.external]
file = "sensed.csv"
delimiter = ";"
columns = ["e1", "e2"]
unit = "N.m"
side = "joint"
[signal]
cutoff_hz = 40.0
ends = "second-order"
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.05
"""

BAG = """\
schema = 1
robot = "arm.urdf"
[[recording]]
[recording.time]
file = "run"
topic = "/joint_states"
resample = true
[recording.position]
file = "run"
topic = "/joint_states"
unit = "rad"
side = "joint"
[recording.torque]
file = "run"
topic = "/joint_states"
columns = ["shoulder", "elbow"]
unit = "N.m"
side = "joint"
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

SCENARIOS: tuple[tuple[list[str], str, int], ...] = (
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


def make(folder: Path, motion: tuple[Array, Array, Array, Array]) -> None:
    """Write every file of the scenarios into a folder, which is the working folder.

    Parameters
    ----------
    folder : Path
        Has the files of `fuzz_material` already.
    motion : tuple of arrays
        Times (m,), positions, velocities and torques of the arm, (m, 2).
    """
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
