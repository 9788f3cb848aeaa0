"""The model of an MJCF in MuJoCo, with a fixed base: its joints, its position servos and its integrator.

Tested in ``tests/test_in_mujoco.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .._tools.inputs import check_input
from .._tools.plugins import optional
from ..errors import FitError
from ..export.drives import Drives


def load_model(path: Path) -> Any:
    """Load an MJCF with a fixed base, without contacts, joint limits and missing meshes.

    Raises
    ------
    FitError
        Without the package mujoco, or for a file that it cannot load.
    """
    needed = "a validation in MuJoCo needs the package mujoco: pip install 'didim[mujoco]'"
    mujoco = optional("mujoco", FitError, needed)
    check_input(path, FitError)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for element in [
            *spec.keys,
            *(joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE),
        ]:
            _delete(spec, element)
        for body in spec.bodies:
            if hasattr(
                body, "simple"
            ):  # MuJoCo 4: another centre of mass, by a load, is refused for such bodies
                body.simple = 0
        try:
            model = spec.compile()
        except ValueError:
            for element in [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH] + list(
                spec.meshes
            ):
                _delete(spec, element)
            model = spec.compile()
    except ValueError as reason:
        raise FitError(
            f"{path.name}: MuJoCo cannot load it ({' '.join(str(reason).split())[:120]})"
        ) from None
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT)
    return model


def _delete(spec: Any, element: Any) -> None:
    """Delete an element, with the interface of MuJoCo before or after 3.3.3."""
    if hasattr(spec, "delete"):
        spec.delete(element)
    else:
        element.delete()


def places_of(model: Any, drives: Drives, name: str) -> tuple[list[int], list[int], list[int | None]]:
    """Return the addresses of the joints' positions and velocities, and their position actuators, whose commands are positions.

    Others that pull towards a position are switched off: the torques of their joints are those of the drives' gains.
    """
    import mujoco

    places, speeds, servo = [], [], []
    for drive in drives.joints:
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, drive.joint)
        if joint < 0:
            raise FitError(f"{name}: there is no joint {drive.joint!r}")
        places.append(int(model.jnt_qposadr[joint]))
        speeds.append(int(model.jnt_dofadr[joint]))
        own = [
            k
            for k in range(model.nu)
            if model.actuator_trnid[k, 0] == joint
            and model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT
            and model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
            and model.actuator_gainprm[k, 0] == -model.actuator_biasprm[k, 1]
            and model.actuator_gear[k, 0] == 1.0
        ]
        if not own and drive.kp is None:
            raise FitError(
                f"{name}: joint {drive.joint!r} has no position actuator, and the result has no gains"
            )
        servo.append(own[0] if own else None)
    for k in range(model.nu):
        if k not in servo and model.actuator_biasprm[k, 1]:
            model.actuator_gainprm[k] = model.actuator_biasprm[k] = 0.0
    return places, speeds, servo


def integrator_of(model: Any) -> str:
    """Return the name of a model's integrator, as an MJCF has it."""
    import mujoco

    name = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
    return {"IMPLICIT": "implicit", "IMPLICITFAST": "implicitfast", "RK4": "RK4"}.get(name, "Euler")
