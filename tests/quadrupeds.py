"""Simulated twins of robots that are commanded in positions: their files as users have them, and logs by MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

LEGS = {"FL": (0.2, 0.05), "FR": (0.2, -0.05)}
"""Names of the legs, and where they are on the trunk (m)."""
PARTS = ("hip", "calf")
"""Driven parts of a leg."""
FILE = {"armature": 0.01, "damping": 0.6, "frictionloss": 0.2}
"""Properties of every drive in the user's file."""

_LEG = """
      <body name="{leg}_hip" pos="{x} {y} 0">
        <inertial pos="0 0.02 -0.05" mass="1.1" diaginertia="0.006 0.006 0.001"/>
        <joint name="{leg}_hip_joint" axis="0 1 0"/>
        <body name="{leg}_calf" pos="0 0 -0.2">
          <inertial pos="0.006 0 -0.12" mass="0.3" diaginertia="0.0015 0.0015 0.0001"/>
          <joint name="{leg}_calf_joint" axis="0 1 0"/>
        </body>
      </body>"""

_ROBOT = """<mujoco model="twin">
  <!-- The trunk floats; it stands on a rack for a log. -->
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><joint armature="{armature}" damping="{damping}" frictionloss="{frictionloss}"/></default>
  <worldbody>
    <body name="trunk" pos="0 0 0.5">
      <freejoint/>
      <inertial pos="0 0 0" mass="6" diaginertia="0.1 0.1 0.1"/>{legs}
    </body>
  </worldbody>
  <actuator>{actuators}
  </actuator>
</mujoco>
"""


def robot_text() -> str:
    """The MJCF of the user, with motors and a floating trunk."""
    legs = "".join(_LEG.format(leg=leg, x=x, y=y) for leg, (x, y) in LEGS.items())
    actuators = "".join(
        f'\n    <motor ctrlrange="-23.7 23.7" joint="{leg}_{part}_joint"/>' for leg in LEGS for part in PARTS
    )
    return _ROBOT.format(legs=legs, actuators=actuators, **FILE)


def followed(
    mujoco: Any,
    text: Any,
    r: np.ndarray,
    rate_hz: float,
    delay_s: float,
    step_s: float = 2.5e-4,
    push: Callable[[float, np.ndarray], Sequence[float]] | None = None,
) -> np.ndarray:
    """Positions of the robot of an MJCF, text or model, (n_samples, n_joints), while its servos follow commands that act late.

    A push gives further torques of the joints (N.m), (n_joints,), by time (s) and position.
    """
    model = mujoco.MjModel.from_xml_string(text) if isinstance(text, str) else text
    model.opt.timestep = step_s
    steps, late = round(1.0 / (rate_hz * model.opt.timestep)), round(delay_s / model.opt.timestep)
    data = mujoco.MjData(model)
    data.qpos[:] = r[0]
    q = np.empty_like(r)
    for k in range(len(r)):
        q[k] = data.qpos
        for first, last in ((0, late % steps), (late % steps, steps)):  # a command acts within a sample
            data.ctrl[:] = r[max(k * steps + first - late, 0) // steps]
            if push is None:
                mujoco.mj_step(model, data, nstep=last - first)
                continue
            for number in range(first, last):
                data.qfrc_applied[:] = push((k * steps + number) * step_s, data.qpos)
                mujoco.mj_step(model, data)
    return q


def recorded(file: str, position: str, reference: str) -> str:
    """Return the tables of a recording's columns in an experiment file: positions and their commands, variables of one file."""
    return "".join(
        f'[recording.{kind}]\nfile = "{file}"\nvariable = "{variable}"\nunit = "rad"\nside = "joint"\n'
        for kind, variable in (("position", position), ("reference", reference))
    )


# A hobby arm.

ARM_RATE, ENCODER = 50.0, 2.0 * np.pi / 4096.0
ARM_TRUTH = {"armature": 0.028, "damping": 0.6, "frictionloss": 0.12}
ARM_DELAY_S, GRIPPER = 0.02, (-0.17, 1.75)
"""Twins log at 50 Hz, in steps of the encoder (rad), and act two hundredths of a second late."""

_ARM = """<mujoco model="so101">
  <compiler angle="radian"/>
  <option integrator="implicitfast"/>
  <default><joint{drive}/><position kp="17.8" kv="0.5" forcerange="-3.35 3.35"/></default>
  <worldbody>
    <body name="shoulder" pos="0 0 0.06">
      <inertial pos="0.02 0 0.03" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
      <joint name="shoulder_pan" axis="0 0 1" range="-1.92 1.92"/>
      <body name="upper_arm" pos="0.03 0 0.05">
        <inertial pos="0 0 0.06" mass="0.12" diaginertia="2e-4 2e-4 5e-5"/>
        <joint name="shoulder_lift" axis="0 1 0" range="-1.75 1.75"/>
        <body name="lower_arm" pos="0 0 0.12">
          <inertial pos="0.07 0 0" mass="0.16" diaginertia="5e-5 3e-4 3e-4"/>
          <joint name="elbow_flex" axis="0 1 0" range="-1.7 1.7"/>
          <body name="jaw" pos="0.14 0 0">
            <inertial pos="0.04 0 0" mass="0.03" diaginertia="1e-5 2e-5 2e-5"/>
            <joint name="gripper" axis="0 1 0" range="{gripper}"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="shoulder_pan"/>
    <position joint="shoulder_lift"/>
    <position joint="elbow_flex"/>
    <position joint="gripper"/>
  </actuator>
</mujoco>
"""


def arm_text(*, truth: bool = False) -> str:
    """The MJCF of a hobby arm as one downloads it, without drives; or that of the truth."""
    values = ARM_TRUTH if truth else {"armature": 0.1, "damping": 0.1, "frictionloss": 0.05}
    drive = "".join(f' {key}="{value}"' for key, value in values.items())
    return _ARM.format(drive=drive, gripper=" ".join(map(str, GRIPPER)))


def arm_episodes(mujoco: Any, count: int = 3, seconds: float = 4.0) -> list[dict[str, np.ndarray]]:
    """Episodes of a LeRobot log: actions and observations in degrees, the gripper in percent of its range."""
    low, high = GRIPPER
    found = []
    for episode in range(count):
        rng = np.random.default_rng(episode)
        t = np.arange(round(seconds * ARM_RATE)) / ARM_RATE
        r = 0.35 * np.sin(2.0 * np.pi * np.outer(t, rng.uniform(0.2, 0.8, 4)) + rng.uniform(0.0, 6.0, 4))
        jumps = np.repeat(rng.uniform(-0.35, 0.35, (round(seconds), 4)), round(ARM_RATE), axis=0)
        r = np.where((t % 4.0 > 2.0)[:, None], jumps, r) + np.array([0.0, 0.2, 0.4, 0.7])
        q = followed(mujoco, arm_text(truth=True), r, ARM_RATE, ARM_DELAY_S)
        q = np.round(q / ENCODER) * ENCODER
        both = [np.degrees(values) for values in (r, q)]
        for values, source in zip(both, (r, q), strict=True):
            values[:, 3] = 100.0 * (source[:, 3] - low) / (high - low)
        found.append({"action": both[0], "observation.state": both[1], "timestamp": t})
    return found
