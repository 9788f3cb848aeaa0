"""Are MJCFs read as MuJoCo compiles them?

    python benches/mjcf_corpus.py FOLDER [FOLDER ...] [--json OUT.json]

reads each MJCF below the folders with `didim.load_robot` and compares it with MuJoCo's model at random states: M(q) with
armatures, inverse dynamics without constraints, which has the passive forces of springs and dampers, ties between joints, gains,
lags, limits and meaning of commands of actuators, limits and friction of joints. A difference is **told** where it vanishes as
soon as what the notes name is switched off in MuJoCo's model, or where the file is refused in a sentence; else it is **silent**.
Actuators that no robot has, such as muscles, are counted apart of the other told ones: M and the torques then agree. Files that
MuJoCo itself refuses, and those without a joint that moves, are counted apart. Ends with 1 if a difference is silent.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import didim
from didim.errors import DidimError
from didim.robot.payload import LARGEST

STATES = 3
"""Random states at which a file is compared."""
TOLERANCE = 1e-9
"""Largest difference, as a share of the largest entry, of two equal results."""
FAR = 5e9
"""A command beyond all limits; MuJoCo refuses those above 1e10."""
SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
"""Joints with one coordinate."""
JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
"""Transmissions to one joint."""
TENDON, WRAPPED = int(mujoco.mjtTrn.mjTRN_TENDON), int(mujoco.mjtWrap.mjWRAP_JOINT)
"""Transmission to a tendon, and what a fixed one wraps."""


def compiled(path: Path) -> Any:
    """Return MuJoCo's model; where files of textures or meshes are missing, without what needs them."""
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        spec = mujoco.MjSpec.from_file(str(path))
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for element in [*spec.skins, *spec.textures]:
        spec.delete(element)
    try:
        return spec.compile()
    except ValueError:
        pass
    kinds = mujoco.mjtGeom
    for geom in list(spec.geoms):
        if geom.meshname or geom.type in (kinds.mjGEOM_MESH, kinds.mjGEOM_HFIELD, kinds.mjGEOM_SDF):
            if not geom.parent.explicitinertial:
                geom.parent.mass, geom.parent.inertia, geom.parent.explicitinertial = 1.0, [1.0] * 3, True
            spec.delete(geom)
    for element in [*spec.meshes, *spec.hfields]:
        spec.delete(element)
    return spec.compile()


class File:
    """A robot beside MuJoCo's model of the same file."""

    def __init__(self, robot: didim.Robot, model: Any) -> None:
        self.robot, self.model, self.data = robot, model, mujoco.MjData(model)
        names = list(robot.all_joint_names)
        own = {self.joint_name(j): j for j in range(model.njnt)}
        if not set(names) <= set(own):  # unnamed joints of unnamed bodies, in their order
            own = dict(zip(names, [j for j in range(model.njnt) if model.jnt_type[j] in SCALAR], strict=True))
        self.joints = [own[name] for name in names]
        self.dofs = [int(model.jnt_dofadr[j]) for j in self.joints]
        self.places = [int(model.jnt_qposadr[j]) for j in self.joints]
        n = robot.n_dof
        self.spread = np.zeros((model.nv, n))
        self.spread[self.dofs[:n], range(n)] = 1.0
        for dof, follower in zip(self.dofs[n:], robot.geometry.followers, strict=True):
            for leader, factor in follower.leaders:
                self.spread[dof, leader] = factor
        assert robot.correspondence is not None
        self.held = {own[name]: value for name, value in robot.correspondence.lock if name in own}

    def joint_name(self, j: int) -> str:
        """Return the name that didim gives a joint."""
        model = self.model
        body = int(model.jnt_bodyid[j])
        stem = model.body(body).name or f"body_{body}"
        number = "" if model.body_jntnum[body] == 1 else str(j - int(model.body_jntadr[body]) + 1)
        return model.joint(j).name or f"{stem}_joint{number}"

    def place(self, q: np.ndarray) -> None:
        """Put MuJoCo's model at positions of the driven joints."""
        model, n = self.model, self.robot.n_dof
        self.data.qpos[:] = model.qpos0
        for j, value in self.held.items():
            if model.jnt_type[j] in SCALAR and model.dof_damping[model.jnt_dofadr[j]] <= LARGEST:
                self.data.qpos[model.jnt_qposadr[j]] = value
        offsets = [follower.offset for follower in self.robot.geometry.followers]
        self.data.qpos[self.places] = self.spread[self.dofs] @ q + np.array([0.0] * n + offsets)

    def replay(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return torques of the driven joints without constraints and actuators, and inertia matrices."""
        model, off = self.model, mujoco.mjtDisableBit
        model.opt.disableflags |= int(off.mjDSBL_CONSTRAINT) | int(off.mjDSBL_ACTUATION)
        tau, matrices = np.zeros_like(q), np.zeros((*q.shape, q.shape[1]))
        for k in range(len(q)):
            self.place(q[k])
            self.data.qvel[:], self.data.qacc[:] = self.spread @ dq[k], self.spread @ ddq[k]
            mujoco.mj_inverse(model, self.data)
            tau[k] = self.spread.T @ self.data.qfrc_inverse
            whole = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, self.data, whole)
            matrices[k] = self.spread.T @ whole @ self.spread
        return tau, matrices

    def differences(self) -> list[str]:
        """Return what differs."""
        robot, model, n = self.robot, self.model, self.robot.n_dof
        random = np.random.default_rng(0)
        q, dq, ddq = (random.normal(0.0, scale, (STATES, n)) for scale in (0.8, 1.0, 2.0))
        off = mujoco.mjtDisableBit
        flags = int(model.opt.disableflags)
        found = self._joints()
        if "mjcf" in robot.sets:
            x = robot.parameter_set("mjcf").copy()
            x[[name.startswith(("Fc", "Fcm")) for name in robot.parameter_names]] = 0.0
            tau, M = didim.inverse_dynamics(robot, q, dq, ddq, x), didim.inertia_matrix(robot, q, x)
            theirs, matrices = self.replay(q, dq, ddq)
            for what, ours, other in (("inertia matrix", M, matrices), ("torques", tau, theirs)):
                size = max(np.abs(other).max(), 1e-300)
                if not np.abs(ours - other).max() <= TOLERANCE * size:
                    found.append(f"{what} {np.abs(ours - other).max() / size:.1e}")
        model.opt.disableflags = flags | int(off.mjDSBL_CONSTRAINT) | int(off.mjDSBL_CLAMPCTRL)
        found += self._gains(q, dq) + self._limits()
        model.opt.disableflags = flags
        return found

    def _joints(self) -> list[str]:
        model, robot = self.model, self.robot
        found = []
        values = dict(zip(robot.parameter_names, robot.sets.get("mjcf", ()), strict=False))
        for k, (j, dof) in enumerate(zip(self.joints, self.dofs, strict=True)):
            if "mjcf" in robot.sets and not model.ntendon:
                found += self._same("frictionloss", j, values[f"Fc{k + 1}"], model.dof_frictionloss[dof])
            if k < robot.n_dof:
                limits = robot.limits[k].position or (-np.inf, np.inf)
                theirs = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
                for ours, other in zip(limits, theirs, strict=True):
                    found += self._same("range", j, ours, other)
        return found

    def _same(self, what: str, j: int, ours: float, other: float) -> list[str]:
        same = ours == other or abs(ours - other) <= TOLERANCE * max(1.0, abs(other))
        return [] if same else [f"{what} of {self.joint_name(j)}: {ours:.6g}, {other:.6g}"]

    def arms(self) -> np.ndarray:
        """Return the moments of all actuators on the driven joints at position zero, a row each."""
        model, data = self.model, self.data
        moment = np.zeros((len(model.actuator_trntype), model.nv))
        self.place(np.zeros(self.robot.n_dof))
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        if len(moment):
            rows = data.moment_rownnz, data.moment_rowadr, data.moment_colind
            mujoco.mju_sparse2dense(moment, data.actuator_moment, *rows)
        return moment @ self.spread

    def servos(self) -> np.ndarray:
        """Return which actuators are torques, or position servos or velocity servos of one joint, by their numbers."""
        model, arms = self.model, self.arms()
        found = np.zeros(len(arms), dtype=bool)
        for i, (gain, kind) in enumerate(
            zip(model.actuator_gainprm[:, 0], model.actuator_trntype, strict=True)
        ):
            bias = model.actuator_biasprm[i][:3] * model.actuator_biastype[i]
            steers = bias[1] or bias[2]
            wraps = (
                range(
                    model.tendon_adr[j := model.actuator_trnid[i, 0]],
                    model.tendon_adr[j] + model.tendon_num[j],
                )
                if kind == TENDON
                else ()
            )
            constant = kind in JOINT or (kind == TENDON and all(model.wrap_type[k] == WRAPPED for k in wraps))
            types = (model.actuator_gaintype[i], model.actuator_biastype[i] // 2, model.actuator_dyntype[i])
            follows = types in ((0, 0, 0), (0, 0, 2), (0, 0, 3)) or (types == (0, 0, 1) and bias[1])
            fits = gain != 0.0 if steers else bias[0] == 0.0
            found[i] = (
                constant
                and follows
                and fits
                and max(bias[1:]) <= 0.0
                and (np.count_nonzero(arms[i]) <= 1 or not steers)
            )
        return found

    def _gains(self, q: np.ndarray, dq: np.ndarray) -> list[str]:
        """Compare torques of actuators without commands and limits, less those at zero, which the notes name."""
        model, robot, data = self.model, self.robot, self.data
        limited = {key: getattr(model, key).copy() for key in ("actuator_forcelimited", "jnt_actfrclimited")}
        for key in limited:
            getattr(model, key)[:] = 0
        drives = [*robot.actuators] or [None] * robot.n_dof
        kp = np.array([(drive and drive.kp) or 0.0 for drive in drives])
        kv = np.array([(drive and drive.kv) or 0.0 for drive in drives])
        torques = []
        for place, speed in ((q[0], dq[0]), (0.0 * q[0], 0.0 * q[0])):
            self.place(place)
            data.qvel[:] = self.spread @ speed
            data.ctrl[:], data.act[:] = 0.0, 0.0
            mujoco.mj_forward(model, data)
            torques.append(self.spread.T @ data.qfrc_actuator)
        for key, values in limited.items():
            getattr(model, key)[:] = values
        theirs, ours = torques[0] - torques[1], -kp * q[0] - kv * dq[0]
        commands, arms, servos = self._commands(torques[1]), self.arms(), self.servos()
        found = [f"command of {self.joint_name(self.joints[k])}" for k in commands]
        lags = np.zeros(robot.n_dof)
        filters = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
        for i in np.flatnonzero(servos):
            if model.actuator_dyntype[i] in filters and np.count_nonzero(arms[i]) == 1:
                lags = np.maximum(lags, model.actuator_dynprm[i, 0] * (arms[i] != 0.0))
        for k, drive in enumerate(drives):
            found += self._same("gains", self.joints[k], ours[k], theirs[k])
            if drive and drive.kp:
                found += self._same("lag", self.joints[k], drive.lag_s, lags[k])
        return found

    def _commands(self, at_zero: np.ndarray) -> list[int]:
        """Return joints with a servo whose command is not their position or speed, and whose names the notes lack."""
        model, arms, servos = self.model, self.arms(), self.servos()
        others = np.abs(at_zero) > TOLERANCE
        for i in np.flatnonzero(servos):
            bias = model.actuator_biasprm[i] * model.actuator_biastype[i]
            if steers := -(bias[1] or bias[2]):
                scaled = np.abs(model.actuator_gainprm[i, 0] / steers - arms[i]) > TOLERANCE * np.abs(arms[i])
                others |= (arms[i] != 0.0) & scaled
        note = " ".join(each for each in self.robot.notes if each.startswith("commands that are not"))
        return [
            k
            for k in np.flatnonzero(others).tolist()
            if f"{self.robot.joint_names[k]} = " not in note and " more" not in note
        ]

    def _limits(self) -> list[str]:
        """Compare the largest torques, those of commands beyond all limits."""
        model, n = self.model, self.robot.n_dof
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        torques = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_NONE)
        ctrl_limits = model.actuator_ctrllimited.copy()
        model.actuator_ctrllimited[~torques] = 0  # commands of servos are positions
        largest = np.zeros((2, n))
        arms = self.arms()
        for k in range(n):
            towards = np.sign(arms[:, k] * model.actuator_gainprm[:, 0]) * FAR
            for command, at in ((towards, 0), (-towards, 0), (0.5 * towards, 1), (-0.5 * towards, 1)):
                self.data.ctrl[:] = command[: model.nu]
                self.data.act[:] = 0.0
                for i in np.flatnonzero(model.actuator_actnum == 1):
                    self.data.act[model.actuator_actadr[i]] = command[i]
                mujoco.mj_forward(model, self.data)
                largest[at, k] = max(largest[at, k], abs(self.spread[:, k] @ self.data.qfrc_actuator))
        model.actuator_ctrllimited[:] = ctrl_limits
        ours = [limits.effort for limits in self.robot.limits]
        # A limit does not depend on the command.
        theirs = [far if 0.0 < far <= 1.5 * half and far <= LARGEST else None for far, half in largest.T]
        return [
            each
            for k in range(n)
            for each in self._same("effort", self.joints[k], ours[k] or np.inf, theirs[k] or np.inf)
        ]

    def loops(self) -> bool:
        """Whether a constraint is violated more in one position of the robot than in another."""
        model, n = self.model, self.robot.n_dof
        flags = int(model.opt.disableflags)
        model.opt.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(
            mujoco.mjtDisableBit.mjDSBL_LIMIT
        )
        seen = []
        for q in (np.zeros(n), np.random.default_rng(1).normal(0.0, 0.3, n)):
            self.place(q)
            self.data.qvel[:] = 0.0
            mujoco.mj_forward(model, self.data)
            rows = self.data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
            seen.append(self.data.efc_pos[rows].copy())
        model.opt.disableflags = flags
        return len(seen[0]) != len(seen[1]) or bool((np.abs(seen[0] - seen[1]) > TOLERANCE).any())


def switch_off(file: File, notes: str) -> None:
    """Switch off in MuJoCo's model what the notes name."""
    model = file.model
    if "(gravcomp), and the robot has them" in notes or "(actuatorgravcomp)" in notes:
        model.body_gravcomp[:] = 0.0
    if "fluid" in notes:
        model.opt.density = model.opt.viscosity = 0.0
    if "nonlinear springs" in notes:
        for key in ("jnt_stiffnesspoly", "dof_dampingpoly", "jnt_springyield"):
            if hasattr(model, key):
                getattr(model, key)[:] = 0.0
    for t in range(model.ntendon):
        name = model.tendon(t).name or f"tendon {t + 1}"
        if "of tendons" in notes and (name in notes or " more" in notes):
            for key in ("armature", "damping", "frictionloss", "stiffness"):
                getattr(model, f"tendon_{key}")[t] = 0.0
    for i in np.flatnonzero(~file.servos()) if "actuators other than" in notes else ():
        model.actuator_gainprm[i] = model.actuator_biasprm[i] = 0.0
        model.actuator_gaintype[i] = model.actuator_biastype[i] = 0
    if "kv of" in notes:
        model.actuator_biasprm[:, 2] = 0.0
    if "switches off" in notes:
        for name in ("PASSIVE", "SPRING", "DAMPER", "ACTUATION"):
            if hasattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"):
                model.opt.disableflags &= ~int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))


def verdict(path: Path) -> tuple[str, list[str]]:
    """Return the class of a file, and what speaks for it."""
    try:
        model = compiled(path)
    except (ValueError, mujoco.FatalError) as reason:
        model = None
        refusal = " ".join(str(reason).split())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            robot = didim.load_robot(path, tip="", snap=0.0)
    except DidimError as reason:
        if model is None:
            return "refused by both", [str(reason)]
        moves = [j for j in range(model.njnt) if model.jnt_type[j] in SCALAR]
        return ("told" if moves else "no joint moves"), [str(reason)]
    except Exception as reason:
        return "silent", [f"traceback: {type(reason).__name__}: {reason}"]
    if model is None:
        return "read by didim alone", [refusal]
    notes = " ".join(robot.notes)
    found = File(robot, model).differences()
    words = ["closed loops" in notes, "mocap" in notes]
    if File(robot, model).loops() and not any(words):
        return "silent", [*found, "closed loops are not named"]
    if not found:
        return ("agree, loops named" if any(words) else "agree"), []
    switch_off(File(robot, model), notes)
    left = File(robot, model).differences()
    if left:
        return "silent", left
    drives = all(each.startswith(("gains", "effort", "lag", "command")) for each in found)
    return ("drives told" if drives else "told"), [*found, *robot.notes]


def main() -> int:
    """Compare all files, print what differs and the counts; return 1 if a difference is silent."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--json", type=Path, help="write class and differences of each file")
    options = parser.parse_args()
    files = sorted(
        file.resolve()
        for folder in options.folders
        for file in ([folder] if folder.is_file() else folder.rglob("*"))
        if file.suffix in (".xml", ".mjcf")
        and b"<mujoco" in file.read_bytes().replace(b"<mujocoinclude", b"")
    )
    results = {}
    mujoco.set_mju_user_warning(lambda _: None)
    for file in files:
        kind, why = verdict(file)
        results[str(file)] = {"class": kind, "why": why}
        if kind in ("silent", "told", "drives told", "read by didim alone"):
            print(f"{kind}: {file}\n    " + "\n    ".join(each[:160] for each in why[:6]), flush=True)
    counts = Counter(result["class"] for result in results.values())
    told = counts["told"] + counts["drives told"]
    compared = told + sum(counts[kind] for kind in ("agree", "agree, loops named", "silent"))
    print(f"{len(files)} files: " + ", ".join(f"{count} {kind}" for kind, count in counts.most_common()))
    shares = [100.0 * count / max(compared, 1) for count in (told, counts["drives told"])]
    print(
        f"of {compared} compared {counts['silent']} silent, {shares[0]:.1f} % told ({shares[1]:.1f} % of drives alone)"
    )
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=1))
    return int(counts["silent"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
