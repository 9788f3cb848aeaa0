"""The C header of a robot: compiled as C99 without a warning, equal to the core."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import didim
import simulated
from didim.cli.main import main
from didim.errors import FitError, ShapeError
from didim.export.source import exported_parameters
from didim.robot.friction import FrictionTerm
from didim.robot.robot import Geometry, Robot
from robots import make_robot, random_motion, random_parameters
from test_couplings import coupled
from test_export import saved_fit
from test_friction_terms import motion
from urdfs import random_tree

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
Array = np.ndarray


class Compiled:
    """A header, compiled for itself and called from Python."""

    def __init__(
        self, folder: Path, robot: Robot, x: Array | None, prefix: str = "arm", text: str | None = None
    ) -> None:
        assert COMPILER is not None
        (folder / "arm.h").write_text(
            didim.export.to_c(robot, x if x is not None else [], prefix=prefix) if text is None else text
        )
        source = folder / "arm.c"
        n = robot.n_dof
        source.write_text(
            '#include "arm.h"\n'
            "void tau(const double *q, const double *dq, const double *ddq, double *out);\n"
            "void inertia(const double *q, double *out);\nvoid gravity(const double *q, double *out);\n"
            f"void tau(const double *q, const double *dq, const double *ddq, double *out) {{ {prefix}_tau(q, dq, ddq, out); }}\n"
            f"void inertia(const double *q, double *out) {{ {prefix}_inertia(q, out); }}\n"
            f"void gravity(const double *q, double *out) {{ {prefix}_gravity(q, out); }}\n"
        )
        flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-ffp-contract=off"]
        library = folder / "arm.so"
        subprocess.run([COMPILER, *flags, "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
        self.library, self.n = ctypes.CDLL(str(library)), n

    def call(self, name: str, size: int, *rows: Array) -> Array:
        out = np.empty((len(rows[0]), size))
        pointer = ctypes.POINTER(ctypes.c_double)
        for k in range(len(out)):
            taken = [np.ascontiguousarray(row[k]) for row in (*rows, out)]
            getattr(self.library, name)(*(one.ctypes.data_as(pointer) for one in taken))
            out[k] = taken[-1]
        return out


def worst(found: Array, expected: Array) -> float:
    return float(np.abs(found - expected).max() / max(1.0, np.abs(expected).max()))


def check(folder: Path, robot: Robot, x: Array, seed: int = 0) -> None:
    """All three functions against the core."""
    n = robot.n_dof
    motion = random_motion(np.random.default_rng(seed), 20, n)
    motion.dq[0] = 0.0  # at rest
    motion.dq[1] *= 0.01
    compiled = Compiled(folder, robot, x)
    tau = compiled.call("tau", n, motion.q, motion.dq, motion.ddq)
    assert worst(tau, didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)) < 1e-12
    inertia = compiled.call("inertia", n * n, motion.q)
    assert worst(inertia, didim.inertia_matrix(robot, motion.q, x).reshape(-1, n * n)) < 1e-12
    still = np.zeros_like(motion.q)
    bodies = x.copy()
    bodies[[name.startswith(("F", "Off", "Rest")) for name in robot.parameter_names]] = 0.0  # springs stay
    gravity = compiled.call("gravity", n, motion.q)
    assert worst(gravity, didim.inverse_dynamics(robot, motion.q, still, still, bodies)) < 1e-12
    assert worst(gravity, didim.gravity(robot, motion.q, x)) < 1e-12


pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


def test_packaged_robots(tmp_path: Path) -> None:
    for name, chosen in (("tx40", "didim"), ("emps", "published"), ("planar2", "reference")):
        robot = didim.load_robot(name)
        folder = tmp_path / name
        folder.mkdir()
        check(folder, robot, robot.sets[chosen])


@pytest.mark.parametrize("seed", range(6))
def test_random_arms_with_every_friction(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    kinds = tuple(rng.choice(["revolute", "prismatic"], n).tolist())
    coupling = np.eye(n)
    if n > 2:
        coupling[2, 0], coupling[2, 1] = 0.5, -1.0
    plain = make_robot(random_geometry(rng, kinds, coupling))
    values = tuple((0.1 * np.arange(9.0) ** 2).tolist())
    terms = (
        FrictionTerm(law="rest", joint=0),
        FrictionTerm(law="atan", joint=0, velocity=0.7),
        FrictionTerm(law="stribeck", joint=n - 1, velocity=0.9),
        FrictionTerm(law="root", joint=n - 1),
        FrictionTerm(law="load", joint=0),
        FrictionTerm(law="table", joint=n - 1, name="Fu", first=-1.5, step=0.3, values=values),
    )
    smooth = seed % 2 == 0
    robot = replace(
        plain,
        friction=replace(
            plain.friction,
            model="asymmetric" if seed % 3 == 0 else "symmetric",
            coulomb="tanh" if smooth else "sign",
            coupling="printed" if seed == 4 else "shaft",
            smoothing=(0.2 if smooth else 0.0,) * n,
            dead_zone=(0.0 if seed == 2 else 0.1,) * n,
            terms=terms[1:] if seed == 2 else terms,
        ),
    )
    check(tmp_path, robot, random_parameters(rng, robot), seed)


@pytest.mark.parametrize("seed", range(3))
def test_trees(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "tree.urdf"
    path.write_text(random_tree(np.random.default_rng(seed), 7))
    robot = didim.load_robot(path, tip="", snap=0.0)
    assert not robot.geometry.in_line
    check(tmp_path, robot, robot.parameter_set("urdf"), seed)


@pytest.mark.parametrize("seed", range(8))
def test_joints_that_follow_others(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = tmp_path / "tree.urdf"
    path.write_text(coupled(rng, 3 + seed))
    robot = didim.load_robot(path, tip="", snap=0.0)
    n = robot.n_dof
    assert n < robot.n_joints == 3 + seed
    terms = (
        (FrictionTerm(law="root", joint=0), FrictionTerm(law="spring", joint=n - 1)) if seed % 4 == 3 else ()
    )
    smooth = seed % 2 == 0
    friction = replace(
        robot.friction,
        model="asymmetric" if seed % 4 == 1 else "symmetric",
        coulomb="tanh" if smooth else "sign",
        smoothing=tuple(rng.uniform(0.1, 0.3, n).tolist()) if smooth else (0.0,) * n,
        dead_zone=tuple(rng.uniform(0.0, 0.2, n).tolist()),
        terms=terms,
    )
    robot = replace(robot, friction=friction)
    check(tmp_path, robot, random_parameters(rng, robot), seed)


def random_geometry(rng: np.random.Generator, kinds: tuple[str, ...], coupling: Array) -> Geometry:
    n = len(kinds)
    angles = rng.choice([0.0, np.pi / 2, -np.pi / 2, 0.4], (2, n))
    lengths = rng.choice([0.0, 0.3, -0.2], (2, n))
    return Geometry(
        kinds=kinds,
        alpha=tuple(angles[0].tolist()),
        d=tuple(lengths[0].tolist()),
        theta=tuple(angles[1].tolist()),
        r=tuple(lengths[1].tolist()),
        gravity=(1.0, -2.0, -9.0),
        coupling=tuple(tuple(row) for row in coupling.tolist()),
    )


def test_base_parameters_and_a_prefix_from_the_name() -> None:
    robot = didim.load_robot("tx40")
    text = didim.export.to_c(robot, robot.sets["didim"])
    assert "static inline void tx40_tau(const double q[6]" in text
    assert "#define TX40_DOF 6" in text
    assert text.count(" *   ") == 60
    assert "malloc" not in text
    named = didim.export.to_c(replace(robot, name="7-axis arm */"), robot.sets["didim"])
    assert "void robot_7_axis_arm_tau(" in named
    assert "of 7-axis arm * /:" in named
    with pytest.raises(FitError, match="begin with a letter"):
        didim.export.to_c(robot, robot.sets["didim"], prefix="2x")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = didim.load_robot("planar2")
    named = ["export", "--parameters", "reference", "--robot", "planar2", "--c"]
    assert main(named) == 0
    assert capsys.readouterr().out == didim.export.to_c(robot, robot.sets["reference"])
    out = tmp_path / "arm.h"
    assert main([*named, "--prefix", "rig", "-o", str(out)]) == 0
    assert "#define RIG_DOF 2" in out.read_text()
    assert main([*named, "-o", str(out)]) == 2
    assert main([*named, "--prefix", "2x"]) == 2
    assert main([*named[:-1], "--mjcf", "--prefix", "rig"]) == 2
    assert "--prefix is for --c" in capsys.readouterr().err


def test_a_result_keeps_its_friction(tmp_path: Path) -> None:
    """Load and atan friction, smoothing and dead zones of a result are in the header, which equals the core."""
    robot = didim.load_robot("planar2")
    terms = (FrictionTerm(law="atan", joint=0, velocity=0.7), FrictionTerm(law="load", joint=1))
    shape = replace(robot.friction, coulomb="tanh", smoothing=(0.05, 0.1), terms=terms)
    made = replace(robot, friction=shape)
    x = np.concatenate([random_parameters(np.random.default_rng(1), robot), [1.5, 0.05]])
    path = saved_fit(made, x, tmp_path / "fit.json")
    saved = json.loads(path.read_text())
    saved["settings"]["robot"]["friction"] = asdict(shape)
    path.write_text(json.dumps(saved))
    source = exported_parameters(fit=path, parameters=None, robot="planar2", urdf=None, further_terms=True)
    assert source.robot.friction.terms == terms
    check(tmp_path, source.robot, source.x)
    motion = random_motion(np.random.default_rng(2), 5, 2)
    state = motion.q, motion.dq, motion.ddq
    assert (
        worst(didim.inverse_dynamics(source.robot, *state, source.x), didim.inverse_dynamics(made, *state, x))
        < 1e-9
    )


def test_a_result_in_place_of_its_parameters_is_named() -> None:
    robot = didim.load_robot("planar2")
    fit = didim.identify(simulated.experiment(robot, simulated.log(robot, robot.parameter_set("reference"))))
    with pytest.raises(
        ShapeError, match=r"x is a result \(Identification\): pass its standard parameters, fit\.parameters"
    ):
        didim.export.to_c(robot, fit)  # type: ignore[arg-type]
    assert didim.export.to_c(robot, fit.parameters).startswith("/* Inverse dynamics of planar2")


def test_friction_that_remembers_carries_its_states(tmp_path: Path) -> None:
    assert COMPILER is not None
    terms = [
        FrictionTerm(law="hold", joint=0),
        FrictionTerm(law="stribeck", joint=0, velocity=0.3),
        FrictionTerm(law="dahl", joint=0, velocity=0.02),
        FrictionTerm(law="dahl", joint=1, velocity=0.01),
    ]
    robot = didim.load_robot("planar2").with_friction(coulomb="sign", dead_zone_rad_s=0.05).with_terms(terms)
    x = random_parameters(np.random.default_rng(3), robot)
    (tmp_path / "arm.h").write_text(didim.export.to_c(robot, x, prefix="arm"))
    source = tmp_path / "arm.c"
    pointers = "const double *q, const double *dq, const double *ddq"
    source.write_text(
        '#include "arm.h"\n'
        f"void tau({pointers}, double *z, double *out);\nvoid remember(const double *dx, double *z);\n"
        f"void tau({pointers}, double *z, double *out) {{ arm_tau(q, dq, ddq, z, out); }}\n"
        "void remember(const double *dx, double *z) { arm_remember(dx, z); }\n"
    )
    library = tmp_path / "arm.so"
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    subprocess.run([COMPILER, *flags, "-o", library, source, "-lm"], check=True)
    code, pointer = ctypes.CDLL(str(library)), ctypes.POINTER(ctypes.c_double)

    def at(array: Array) -> object:
        return array.ctypes.data_as(pointer)

    q, dq, ddq = (np.ascontiguousarray(values[:400]) for values in motion())
    found, z = np.zeros_like(q), np.sign(dq[0])[[0, 0, 1]]
    for k in range(len(q)):
        if k:
            code.remember(at(np.ascontiguousarray(q[k] - q[k - 1])), at(z))
        code.tau(at(q[k]), at(dq[k]), at(ddq[k]), at(z), at(found[k]))
    assert worst(found, didim.inverse_dynamics(robot, q, dq, ddq, x)) < 1e-9


def test_friction_is_smooth_on_request_and_names_have_one_underscore(tmp_path: Path) -> None:
    robot = didim.load_robot("tx40")
    x = robot.sets["didim_physical"]
    smooth = didim.export.to_c(robot, x, prefix="tip_", smoothing=0.05)
    assert "__" not in smooth
    assert "sign(" not in smooth
    compiled = Compiled(tmp_path, robot, None, "tip", smooth)
    motion = random_motion(np.random.default_rng(0), 20, 6)
    motion.dq[:5] *= 0.01
    own = robot.with_friction(coulomb="tanh", smoothing_rad_s=0.05)
    expected = didim.inverse_dynamics(own, motion.q, motion.dq, motion.ddq, x)
    assert worst(compiled.call("tau", 6, motion.q, motion.dq, motion.ddq), expected) < 1e-12
    with pytest.raises(FitError, match="smoothing must be a positive number"):
        didim.export.to_c(robot, x, smoothing=0.0)


def test_the_header_names_the_joints() -> None:
    robot = didim.load_robot(Path(didim.__file__).parent / "packaged" / "examples" / "ur10e" / "ur10e.urdf")
    header = didim.export.to_c(robot, robot.parameter_set("urdf"))
    assert "1 shoulder_pan_joint (revolute), 2 shoulder_lift_joint (revolute)" in header
