"""An MJCF, as MuJoCo compiles it, as the description of a URDF: bodies, joints, drives, ties and tendons.

A body with several joints becomes several links, the last of which has the inertia; free and ball joints are fixed, and so are
joints nailed down by their damping. What the model has and a robot has not is named in the notes.
Tested in ``tests/test_mjcf.py`` against MuJoCo.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import series
from ...errors import RobotError
from ..payload import LARGEST
from ..rigid_body import pose
from ..robot import JointLimits
from ..transmission import TIME_CONSTANT_S, softness
from .mechanism import MOVING, UNLIMITED, Description, Inertial, Loop, Servo, Tendon, UrdfJoint
from .mjcf_compiler import Compiled, compile_mjcf
from .xml_spans import Element

WORLD = "world"
"""Name of MuJoCo's outermost body."""

KINDS = ("floating", "spherical", "prismatic", "revolute")
"""URDF name of each of MuJoCo's types of joints, in their order."""

LEAST_IMPEDANCE = 1e-4
"""Distance of MuJoCo's impedances from 0 and 1."""


def read_mjcf(outermost: Element, path: Path) -> Description:
    """Read an MJCF.

    Parameters
    ----------
    outermost : Element
        Content of the file.
    path : Path
        The file, whose name opens each message; included files and meshes are relative to its folder.

    Raises
    ------
    RobotError
        As for `compile_mjcf`, for a file without bodies, and for numbers beyond all robots.
    """
    try:
        return Reader(compile_mjcf(outermost, path), path.name).description()
    except UnicodeDecodeError:
        raise RobotError(f"{path.name}: its names are neither ASCII nor UTF-8; save it as UTF-8") from None


@dataclass(eq=False)
class Reader:
    """The compiled model, read body by body."""

    compiled: Compiled
    where: str
    links: dict[str, Inertial | None] = field(default_factory=lambda: {WORLD: None})
    joints: dict[str, UrdfJoint] = field(default_factory=dict)
    names: dict[int, str] = field(default_factory=dict)
    children: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    unlike: list[str] = field(default_factory=list)

    @property
    def model(self) -> Any:
        """MuJoCo's model."""
        return self.compiled.model

    @cached_property
    def mujoco(self) -> Any:
        """The package."""
        return self.compiled.mujoco

    @cached_property
    def bodies(self) -> list[str]:
        """Names of the bodies, made up where the file has none."""
        return [WORLD, *(self.model.body(b).name or f"body_{b}" for b in range(1, self.model.nbody))]

    @property
    def gravcomp(self) -> dict[str, float]:
        """Share of its weight that each body does not feel."""
        return {self.bodies[b]: float(each) for b, each in enumerate(self.model.body_gravcomp) if each}

    def name(self, kind: str, index: int) -> str:
        """Return the name of an object of a kind such as "tendon"; its number where the file has none."""
        return getattr(self.model, kind)(index).name or f"{kind} {index + 1}"

    def description(self) -> Description:
        """Return the description of the whole file."""
        model = self.model
        if model.nbody < 2:
            raise RobotError(f"{self.where}: it has no <body>")
        for body in range(1, model.nbody):
            self._body(body)
        loops = self._equalities()
        tendons = [tendon for t in range(model.ntendon) if (tendon := self._tendon(t)) is not None]
        tendons += self._drives()
        self._world()
        off = self.mujoco.mjtDisableBit
        weightless = bool(model.opt.disableflags & int(off.mjDSBL_GRAVITY))
        if weightless:
            self.notes.append("gravity is disabled in the file (didim robot --gravity 0 0 -9.81 restores it)")
        gravity = self._checked(0.0 * model.opt.gravity if weightless else model.opt.gravity, "gravity")
        return Description(
            where=self.where,
            name=model.names[: model.names.index(b"\0")].decode(),
            links=self.links,
            joints=self.joints,
            root=WORLD,
            gravity=tuple(float(g) for g in gravity),
            notes=tuple(self.notes),
            tendons=tuple(tendons),
            loops=tuple(loops),
            gravcomp={} if any(model.jnt_actgravcomp) else self.gravcomp,
            incomplete=tuple(self.bodies[b] for b in sorted(self.compiled.lost)),
        )

    def _checked(self, values: Any, what: str) -> Array:
        numbers = np.array(values, dtype=np.float64)
        if not (np.abs(numbers) <= LARGEST).all():
            raise RobotError(
                f"{self.where}: {what} must be at most {LARGEST:g} in size, got {numbers.tolist()}"
            )
        return numbers

    def _pose(self, quaternion: Any, position: Any, what: str) -> Array:
        rotation = np.zeros(9)
        self.mujoco.mju_quat2Mat(rotation, np.array(quaternion, dtype=np.float64))
        self._checked(rotation, f"orientation of {what}")
        return pose(rotation.reshape(3, 3), self._checked(position, f"pos of {what}"))

    def _body(self, b: int) -> None:
        """Read a body: one link per joint, the last of which is the body itself."""
        model, name = self.model, self.bodies[b]
        parent = self.bodies[model.body_parentid[b]]
        origin = self._pose(model.body_quat[b], model.body_pos[b], name)
        first, count = int(model.body_jntadr[b]), int(model.body_jntnum[b])
        # Each joint turns about an anchor, where the intermediate links have their frames.
        for j in range(first, first + count):
            own = model.joint(j).name or (f"{name}_joint" if count == 1 else f"{name}_joint{j - first + 1}")
            joint = self._joint(j, own)
            anchor = self._checked(model.jnt_pos[j], f"pos of {own}") * (joint.kind in MOVING)
            child = name if j == first + count - 1 and not anchor.any() else f"{name}/{own}"
            # The file draws a joint at its reference position.
            at_zero = origin @ pose(np.eye(3), anchor) @ joint.motion(-joint.zero)
            self._connect(replace(joint, parent=parent, child=child, origin=at_zero))
            self.names[j] = own
            parent, origin = child, pose(np.eye(3), -anchor)
        if parent != name:
            fixed = UrdfJoint(f"{name}_fixed", "fixed", parent, name, origin, np.array([0.0, 0.0, 1.0]))
            self._connect(fixed)
        inertia = self._checked(model.body_inertia[b], f"inertia of {name}")
        mass = float(self._checked(model.body_mass[b], f"mass of {name}"))
        if b in self.compiled.lost or not (mass or inertia.any()):
            self.links[name] = None
            return
        frame = self._pose(model.body_iquat[b], model.body_ipos[b], f"inertial of {name}")
        self.links[name] = Inertial(mass, frame, np.diag(inertia))

    def _connect(self, joint: UrdfJoint) -> None:
        if joint.name in self.children or joint.child in self.joints:
            raise RobotError(f"{self.where}: there are two joints or bodies {joint.name!r}")
        self.links.setdefault(joint.child, None)
        self.children[joint.name] = joint.child
        self.joints[joint.child] = joint

    def _joint(self, j: int, name: str) -> UrdfJoint:
        """Return a joint without parent and child."""
        model, kind = self.model, KINDS[int(self.model.jnt_type[j])]
        dof, place = int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
        axis = self._checked(model.jnt_axis[j], f"axis of {name}")
        if kind not in MOVING:
            return UrdfJoint(name, kind, "", "", np.eye(4), axis)
        zero = float(self._checked(model.qpos0[place], f"ref of {name}"))
        damping = float(model.dof_damping[dof])
        if damping > LARGEST:
            return UrdfJoint(name, f"{kind} with a damping of {damping:g}", "", "", np.eye(4), axis)
        values = (
            damping,
            model.dof_frictionloss[dof],
            model.dof_armature[dof],
            model.jnt_stiffness[j],
            model.qpos_spring[place],
        )
        damping, friction, armature, stiffness, rest = self._checked(
            [float(np.ravel(value)[0]) for value in values],
            f"damping, friction, armature and spring of {name}",
        ).tolist()
        low, high = self._checked(model.jnt_range[j], f"range of {name}").tolist()
        return UrdfJoint(
            name=name,
            kind=kind,
            parent="",
            child="",
            origin=np.eye(4),
            axis=axis,
            limits=JointLimits(position=(low, high) if model.jnt_limited[j] and low < high else None),
            damping=damping,
            friction=friction,
            armature=armature,
            stiffness=stiffness,
            rest=rest,
            zero=zero,
            forces=tuple(model.jnt_actfrcrange[j].tolist()) if model.jnt_actfrclimited[j] else UNLIMITED,
            softness=_softness(model.dof_solref[dof], model.dof_solimp[dof]),
        )

    def _equalities(self) -> list[Loop]:
        """Tie joints to their leaders; return the other active constraints."""
        model, kinds = self.model, self.mujoco.mjtEq
        loops: list[Loop] = []
        held: list[str] = []
        for e in range(model.neq):
            if not model.eq_active0[e]:
                continue
            kind, first, second = (int(model.eq_type[e]), int(model.eq_obj1id[e]), int(model.eq_obj2id[e]))
            name = model.equality(e).name or kinds(kind).name.removeprefix("mjEQ_").lower()
            if kind == int(kinds.mjEQ_JOINT):
                joints = tuple(self.names[j] for j in (first, second) if j >= 0)
                child = self.children[joints[0]]
                rest, slope, *curved = self._checked(model.eq_data[e][:5], f"polycoef of {name}").tolist()
                straight = not any(curved) or second < 0
                if not straight or self.joints[child].mimic is not None:
                    loops.append(Loop(f"{name} ({series(joints, 60)})", joints=joints))
                if self.joints[child].mimic is None:
                    self.joints[child] = self._tied(child, first, second if straight else -1, rest, slope)
            elif kind == int(kinds.mjEQ_TENDON):
                tendons = [self._coefficients(t) or {} for t in (first, second) if t >= 0]
                loops.append(Loop(name, joints=tuple({joint for each in tendons for joint in each})))
            elif kind in (int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)):
                ends = [self._body_of(int(model.eq_objtype[e]), end) for end in (first, second)]
                one, other = (self.bodies[end] for end in ends)
                name = model.equality(e).name or f"{name} of {one} and {other}"
                if any(model.body_mocapid[end] >= 0 for end in ends):
                    held.append(name)
                else:
                    loops.append(Loop(name, links=tuple(self.bodies[end] for end in ends)))
            else:
                loops.append(Loop(name, joints=tuple(self.names.values())))
        if held:
            self.notes.append(f"what ties bodies to mocap bodies is left out: {series(held)}")
        return loops

    def _tied(self, child: str, first: int, second: int, rest: float, slope: float) -> UrdfJoint:
        """Return a joint that follows another; without a second one it stands still."""
        model = self.model
        # Both positions are relative to the pose in which the file draws the joints.
        offset = float(model.qpos0[model.jnt_qposadr[first]]) + rest
        if second < 0:
            return replace(self.joints[child], mimic="", multiplier=0.0, offset=offset)
        offset -= slope * float(model.qpos0[model.jnt_qposadr[second]])
        return replace(self.joints[child], mimic=self.names[second], multiplier=slope, offset=offset)

    def _body_of(self, kind: int, index: int) -> int:
        site = kind == int(self.mujoco.mjtObj.mjOBJ_SITE)
        return int(self.model.site_bodyid[index]) if site else max(index, 0)

    def _coefficients(self, t: int) -> dict[str, float] | None:
        """Coefficients of a fixed tendon by joint; None for a spatial one."""
        model = self.model
        first = int(model.tendon_adr[t])
        entries = range(first, first + int(model.tendon_num[t]))
        if any(model.wrap_type[k] != self.mujoco.mjtWrap.mjWRAP_JOINT for k in entries):
            return None
        coefficients: dict[str, float] = {}
        for k in entries:
            joint = self.names[int(model.wrap_objid[k])]
            coefficients[joint] = coefficients.get(joint, 0.0) + float(model.wrap_prm[k])
        return coefficients

    def _tendon(self, t: int) -> Tendon | None:
        """Return a fixed tendon with forces of its own; note the others."""
        model, name = self.model, self.name("tendon", t)
        keys = ("armature", "damping", "frictionloss", "stiffness")
        values = [float(np.ravel(getattr(model, f"tendon_{key}", np.zeros(t + 1))[t])[0]) for key in keys]
        if not any(values):
            return None
        coefficients = self._coefficients(t)
        low, high = model.tendon_lengthspring[t].tolist()
        if coefficients is None or (values[3] and low != high):
            self.unlike.append(name)
            return None
        numbers = self._checked([*values, low, *coefficients.values()], f"tendon {name}").tolist()
        return Tendon(name, coefficients, *numbers[:5])

    def _world(self) -> None:
        """Note what of the file changes forces and has no place in a robot."""
        model = self.model
        flags = ("PASSIVE", "SPRING", "DAMPER", "FRICTIONLOSS", "EQUALITY", "CONSTRAINT", "ACTUATION")
        bits = {flag: getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag}", 0) for flag in flags}
        left_out = {
            "limits of tendons are left out: ": [
                self.name("tendon", t) for t in range(model.ntendon) if model.tendon_limited[t]
            ],
            "forces of tendons along a path or within a range are left out: ": self.unlike,
            "nonlinear springs and dampers are left out: ": [
                self.names[j] for j in self.names if self._curved(j)
            ],
            "drives carry weights (actuatorgravcomp) beside their commands, which is left out: ": [
                *(self.gravcomp if any(model.jnt_actgravcomp) else ())
            ],
            "the file switches off what the robot has: ": [
                flag.lower() for flag, bit in bits.items() if model.opt.disableflags & int(bit)
            ],
        }
        self.notes += [f"{what}{series(names, 60)}" for what, names in left_out.items() if names]
        if model.opt.density or model.opt.viscosity:
            self.notes.append("forces of the fluid are left out (density, viscosity)")
        if model.nflex or model.nplugin:
            self.notes.append("forces of plugins and of deformable bodies (flex) are left out")

    def _curved(self, j: int) -> bool:
        model, dof = self.model, int(self.model.jnt_dofadr[j])
        places = {"jnt_stiffnesspoly": j, "jnt_springyield": j, "dof_dampingpoly": dof}
        return any(np.any(getattr(model, key)[at]) for key, at in places.items() if hasattr(model, key))

    def _drives(self) -> list[Tendon]:
        """Return the actuators; note what of them a robot has not."""
        model = self.model
        drives = []
        for k in range(len(model.actuator_trntype)):
            name, arms, servo = self.name("actuator", k), self.moments(k), self.servo(k)
            if hasattr(model, "actuator_delay") and model.actuator_delay[k]:
                self.notes.append(f"the delay of actuator {name} is left out")
            if servo.kp and model.actuator_dyntype[k] == self.mujoco.mjtDyn.mjDYN_INTEGRATOR:
                self.notes.append(f"the command of actuator {name} is integrated before it is a position")
            which = series(arms or (name,), 60)
            if servo.kv is None:
                self.notes.append(f"kv of {which} is not known: its damping ratio needs the missing meshes")
            armature, damping = (
                float(np.ravel(getattr(model, key, np.zeros(k + 1))[k])[0])
                for key in ("actuator_armature", "actuator_damping")
            )
            if (armature or damping) and not arms:
                self.unlike.append(name)
            self._checked([*(arms or {}).values()], "gear")
            self._checked([armature, damping, servo.kp, servo.kv or 0.0], f"gains of {which}")
            drives.append(Tendon(name, arms or {}, armature, damping, servo=servo))
        return drives

    def moments(self, k: int) -> dict[str, float] | None:
        """Return the moments of an actuator by joint; None where they are not constant."""
        model, kinds = self.model, self.mujoco.mjtTrn
        gear, target = float(model.actuator_gear[k, 0]), int(model.actuator_trnid[k, 0])
        if int(model.actuator_trntype[k]) == int(kinds.mjTRN_TENDON):
            coefficients = self._coefficients(target)
            return coefficients and {joint: gear * each for joint, each in coefficients.items()}
        if int(model.actuator_trntype[k]) not in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)):
            return None
        joint = self.joints[self.children[self.names[target]]]
        return {joint.name: gear} if joint.kind in MOVING else None

    def servo(self, k: int) -> Servo:
        """Return an actuator by its numbers."""
        model = self.model
        gain, bias = float(model.actuator_gainprm[k, 0]), np.array(model.actuator_biasprm[k][:3])
        gaintype, biastype, dyntype = (
            getattr(self.mujoco, f"mjt{key}")(
                int(getattr(model, f"actuator_{key.lower()}type")[k])
            ).name.split("_")[1]
            for key in ("Gain", "Bias", "Dyn")
        )
        bias *= biastype != "NONE"
        kp, kv = 0.0 - float(bias[1]), 0.0 - float(bias[2])
        steers, lags = kp or kv, dyntype.startswith("FILTER")
        linear = (
            (gaintype, biastype) in (("FIXED", "NONE"), ("FIXED", "AFFINE"))
            and (lags or dyntype == "NONE" or (dyntype == "INTEGRATOR" and kp))
            and min(kp, kv) >= 0.0
            and (gain if steers else not bias[0])
        )
        if not linear:
            return Servo(linear=False)
        forces = np.array(model.actuator_forcerange[k] if model.actuator_forcelimited[k] else UNLIMITED)
        if model.actuator_ctrllimited[k] and not steers:
            forces = np.clip(np.sort(gain * model.actuator_ctrlrange[k]), *forces)
        return Servo(
            kp=kp,
            kv=None if self.compiled.lost and k in self.compiled.ratios else kv,
            forces=tuple(forces.tolist()),
            lag_s=float(model.actuator_dynprm[k, 0]) if lags else 0.0,
            slope=gain / steers if steers else 1.0,
            offset=float(bias[0]) / steers if steers else 0.0,
        )


def _softness(solref: Any, solimp: Any) -> tuple[float, float]:
    """Return creep and rest (s) of a joint's friction loss, `didim.robot.transmission.softness`.

    Two negative numbers of ``solreffriction`` are stiffness and damping, and friction takes the damping. Of a positive and a
    negative one MuJoCo takes neither, but its defaults.
    """
    limit = LEAST_IMPEDANCE
    least, largest = np.clip(np.array(solimp[:2]), limit, 1.0 - limit).tolist()
    time, damping = float(solref[0]), float(solref[1])
    if (time > 0.0) != (damping > 0.0):
        time, damping = TIME_CONSTANT_S, 1.0
    return softness(least, largest, time if time > 0.0 else 2.0 / max(-damping, 1.0 / LARGEST))
