"""Drives of real robots' descriptions from positions alone: in, identified and out in three commands, the truth by MuJoCo.

    python benches/robots_from_positions.py FOLDER [--robots so101 z1 ...]

FOLDER has the URDFs of the package example-robot-data (its folder ``robots``). MuJoCo writes each as MJCF with position actuators
and guessed drives; a log of 12 s at 100 Hz is simulated with other drives and a delay of 8 ms; ``didim init``, ``identify`` and
``export`` follow without a question, and ``validate --mujoco`` replays the log. The log is that of MuJoCo's Runge-Kutta steps:
implicit steps of 0.25 ms alone move armatures by up to 1 % (`didim.export.drives`). Printed are joints, seconds, the share of
the truth in the 95 % intervals, the median error of armatures, damping and friction (per cent), the error of the fit (mrad), that
in MuJoCo over it, the error in MuJoCo at 1 ms with the file for that step (mrad), and the verdict.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

import didim
from didim.cli.main import main as command

ROBOTS = {
    "so101": "so_arm_description/urdf/so101.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "go2": "go2_description/urdf/go2.urdf",
    "anymal": "anymal_b_simple_description/robots/anymal.urdf",
    "g1": "g1_description/urdf/g1_29dof_rev_1_0.urdf",
    "solo": "solo_description/robots/solo12.urdf",
    "allegro": "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "xarm": "xarm_description/urdf/xarm7.urdf",
    "tiago": "tiago_description/robots/tiago_no_hand.urdf",
    "a1": "a1_description/urdf/a1.urdf",
}
"""Descriptions by short name."""

RATE_HZ, SECONDS, DELAY_S, STEP_S = 100.0, 12.0, 0.008, 2.5e-4
BANDWIDTH_HZ = 3.0
"""Natural frequency of the servos: a stiff hobby servo has some 5 Hz, a leg some 3 Hz."""
KINDS = {"Ia": "dof_armature", "Fv": "dof_damping", "Fc": "dof_frictionloss"}


def specification(urdf: Path) -> Any:
    """The robot on a rack, without meshes."""
    spec = mujoco.MjSpec.from_file(str(urdf))
    for item in [*(geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH), *spec.meshes]:
        spec.delete(item)
    for joint in [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]:
        spec.delete(joint)
    for body in spec.bodies:
        xx, yy, zz, xy, xz, yz = body.fullinertia
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if (
            np.isfinite(tensor).all() and not np.linalg.eigvalsh(tensor).min() > 0.0
        ):  # base links have made-up ones
            body.fullinertia = [*(max(moment, 1e-6) for moment in (xx, yy, zz)), 0.0, 0.0, 0.0]
    spec.compiler.balanceinertia = True
    model = spec.compile()
    for body in spec.bodies[1:]:  # as they are balanced: a file that is written has them as they were
        number = model.body(body.name).id
        body.fullinertia = np.full(6, np.nan)
        moments = model.body_inertia[number]
        # Written with six digits, a sum of two moments must still exceed the third.
        body.inertia = np.minimum(moments, 0.999 * (moments.sum() - moments))
        body.ipos, body.iquat = model.body_ipos[number], model.body_iquat[number]
    return spec


def written(urdf: Path, path: Path) -> Any:
    """Write the MJCF of a user, with position actuators and guessed drives, and return its model with the drives of the truth."""
    spec = specification(urdf)
    model = spec.compile()
    inertia = np.zeros((model.nv, model.nv))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    rng = np.random.default_rng(model.nv)
    size = np.maximum(np.diag(inertia), 1e-4)
    kp = 1.4 * size * (2.0 * np.pi * BANDWIDTH_HZ) ** 2 + np.abs(data.qfrc_bias) / 0.1
    kv = 2.0 * 0.4 * np.sqrt(1.4 * size * kp)
    for joint in spec.joints:
        dof = model.joint(joint.name).dofadr[0]
        joint.armature, joint.frictionloss = 0.1 * size[dof], 0.005 * kp[dof]
        if np.ndim(joint.damping):  # a polynomial, since MuJoCo 4
            joint.damping[0] = 0.05 * kv[dof]
        else:
            joint.damping = 0.05 * kv[dof]
        actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gainprm[0], actuator.biasprm[1], actuator.biasprm[2] = kp[dof], -kp[dof], -kv[dof]
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    truth = spec.compile()
    path.write_text(spec.to_xml(), encoding="utf-8")
    truth.dof_armature[:] = size * rng.uniform(0.25, 0.6, model.nv)
    truth.dof_damping[:] = kv * rng.uniform(0.05, 0.3, model.nv)
    truth.dof_frictionloss[:] = kp * rng.uniform(0.01, 0.03, model.nv)
    mujoco.mj_setConst(truth, mujoco.MjData(truth))  # the softness of frictionloss depends on the armatures
    truth.opt.timestep, truth.opt.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_RK4
    truth.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(
        mujoco.mjtDisableBit.mjDSBL_LIMIT
    )
    return truth


def log(model: Any, path: Path) -> None:
    """Simulate waves and jumps about the middle of the joints, and write commands and positions."""
    rng = np.random.default_rng(1)
    n, t = model.nv, np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    wave = 0.2 * np.sin(2.0 * np.pi * np.outer(t, rng.uniform(0.2, 1.0, n)) + rng.uniform(0.0, 6.0, n))
    jumps = np.repeat(rng.uniform(-0.2, 0.2, (round(2 * SECONDS), n)), round(RATE_HZ / 2), axis=0)
    low, high = model.jnt_range.T  # a joint that overshoots the end of its range counts as held there
    share = np.where(model.jnt_limited, np.minimum(1.0, (high - low) / 0.8), 1.0)
    middle = np.where(model.jnt_limited, np.clip(0.0, low + 0.3 * share, high - 0.3 * share), 0.0)
    r = share * np.where((t % 3.0 > 1.5)[:, None], jumps, wave) + middle
    data, q = mujoco.MjData(model), np.empty_like(r)
    steps, late = round(1.0 / (RATE_HZ * STEP_S)), round(DELAY_S / STEP_S)
    data.qpos[:] = r[0]
    for k in range(len(r) * steps):
        if k % steps == 0:
            q[k // steps] = data.qpos
        data.ctrl[:] = r[max(k - late, 0) // steps]
        mujoco.mj_step(model, data)
    np.savez(path, time=t, q=q + 2e-5 * rng.standard_normal(q.shape), q_cmd=r)


def measured(urdf: Path) -> str:
    """The row of a robot."""
    truth = written(urdf, Path("robot.xml"))
    log(truth, Path("log.npz"))
    start = perf_counter()
    for line in (
        "init robot.xml log.npz -o log.toml",
        "identify log.toml --method cloe --json fit.json",
        "export fit.json --mjcf robot.xml -o new.xml",
        "validate fit.json log.toml --mujoco new.xml --json replay.json",
        "export fit.json --mjcf robot.xml -o step.xml --for-step 0.001",
        "validate fit.json log.toml --mujoco step.xml --step 0.001 --json step.json",
    ):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            code = command(line.split())
        if code and not line.startswith("identify"):
            return f"{line.split()[0]} ended with {code}: {printed.getvalue().strip().splitlines()[-1][:120]}"
    seconds = perf_counter() - start
    fit = didim.Identification.load("fit.json")
    names = fit.settings["robot"]["joint_names"]
    inside, count = 0, 0
    errors: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for row in fit.settings["positions"]["rows"]:
        if row["kind"] in KINDS and row["by"] == "log":
            value = getattr(truth, KINDS[row["kind"]])[truth.joint(names[row["joints"][0] - 1]).dofadr[0]]
            errors[row["kind"]].append(100.0 * abs(row["value"] / value - 1.0))
            if row["low"] is not None:
                inside, count = inside + (row["low"] <= value <= row["high"]), count + 1
    replay, step = (
        json.loads(Path(f"{name}.json").read_text(encoding="utf-8")) for name in ("replay", "step")
    )
    own, after = (1e3 * np.sqrt(np.mean(np.square(values))) for values in (replay["own"], step["after"]))
    cells = "".join(f"{np.median(values) if values else np.nan:8.2f}" for values in errors.values())
    shares = f"{len(names):6}{seconds:9.1f}{100.0 * inside / max(count, 1):9.0f}{cells}"
    return f"{shares}{own:9.4f}{replay['ratio']:9.3f}{after:9.3f}  {fit.verdict.state.name.lower()}"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", nargs="+", choices=list(ROBOTS), default=list(ROBOTS))
    options = parser.parse_args()
    print(f"{'':10}joints  seconds  inside%    Ia %    Fv %    Fc %     mrad   MuJoCo  at 1 ms  verdict")
    here = Path.cwd()
    for name in options.robots:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            try:
                row = measured((here / options.folder / ROBOTS[name]).resolve())
            except Exception as reason:  # a row for each robot
                row = f"  {type(reason).__name__}: {' '.join(str(reason).split())[:140]}"
            finally:
                os.chdir(here)
        print(f"{name:10}{row}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
