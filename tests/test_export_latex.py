"""Formulas of small robots: equal to the core, and as a textbook has them."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from didim.errors import FitError
from didim.export.code.latex import symbolic_model
from didim.robot.friction import FrictionTerm
from didim.robot.robot import Robot
from robots import make_robot, random_motion, random_parameters
from test_couplings import COUPLED
from test_export_c import random_geometry, worst

sympy = pytest.importorskip("sympy")


def check(robot: Robot, seed: int = 0) -> None:
    n = robot.n_dof
    motion = random_motion(np.random.default_rng(seed), 10, n)
    x = random_parameters(np.random.default_rng(seed), robot)
    beta = dict(zip(robot.base_parameters.names, robot.base_parameters.project(x), strict=True))
    symbols = [sympy.Symbol(f"{name}{j + 1}", real=True) for name in ("q", "dq", "ddq") for j in range(n)]
    size = float(np.abs(robot.geometry.gravity).sum())
    torques = []
    for terms in symbolic_model(robot):
        total = sum(beta[name] * value for name, value in terms)
        call = sympy.lambdify([*symbols, sympy.Symbol("g", positive=True)], total, "numpy")
        torques.append(call(*motion.q.T, *motion.dq.T, *motion.ddq.T, size))
    expected = didim.inverse_dynamics(robot, motion.q, motion.dq, motion.ddq, x)
    assert worst(np.array(torques).T, expected) < 1e-11


@pytest.mark.slow
def test_formulas_equal_the_core() -> None:
    check(didim.load_robot("planar2"))
    check(didim.load_robot("emps"))
    rng = np.random.default_rng(3)
    plain = make_robot(random_geometry(rng, ("revolute", "prismatic"), np.eye(2)))
    terms = (
        FrictionTerm(law="atan", joint=0, velocity=0.7),
        FrictionTerm(law="stribeck", joint=1, velocity=0.9),
        FrictionTerm(law="root", joint=1),
        FrictionTerm(law="forward", joint=0),
    )
    smooth = replace(plain.friction, coulomb="tanh", smoothing=(0.2, 0.2), terms=terms)
    check(replace(plain, friction=smooth), 3)
    # Dead zones that some of the ten speeds are within.
    check(replace(plain, friction=replace(smooth, dead_zone=(0.5, 0.9))), 3)
    check(replace(plain, friction=replace(plain.friction, dead_zone=(0.9, 0.5))), 3)


@pytest.mark.slow
def test_formulas_of_joints_that_follow_others(tmp_path: Path) -> None:
    path = tmp_path / "slide.toml"
    path.write_text(COUPLED)
    robot = didim.load_robot(path)
    assert (robot.n_dof, robot.n_joints) == (2, 3)
    check(replace(robot, friction=replace(robot.friction, coulomb="tanh", smoothing=(0.2, 0.3))), 3)


def test_a_dead_zone_is_written() -> None:
    robot = didim.load_robot("planar2")
    assert r"\theta" not in didim.export.to_latex(robot)
    text = didim.export.to_latex(replace(robot, friction=replace(robot.friction, dead_zone=(0.01, 0.01))))
    assert text.count(r"\theta\left(\left|{\dot q_{1}}\right| - 0.01\right)") == 1


def test_a_planar_arm_as_textbooks_have_it() -> None:
    text = didim.export.to_latex(didim.load_robot("planar2"))
    assert text.startswith("\\begin{align*}\n\\tau_{1} &= \\mathit{ZZ}_{1R}\\, \\ddot q_{1} \\\\\n")
    assert r"\mathit{MX}_{1R}\, g \cos{\left(q_{1} \right)}" in text
    assert r"g \cos{\left(q_{1} + q_{2} \right)}" in text
    assert r"&\quad + \mathit{Off}_{2}" in text


def test_refusals(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FitError, match="equations of 6 joints fill pages"):
        didim.export.to_latex(didim.load_robot("tx40"))
    robot = didim.load_robot("planar2")
    load = replace(robot.friction, terms=(FrictionTerm(law="load", joint=1),))
    with pytest.raises(FitError, match="Fl2 depends on the load"):
        didim.export.to_latex(replace(robot, friction=load))
    monkeypatch.setitem(sys.modules, "sympy", None)
    with pytest.raises(FitError, match=r"didim\[latex\]"):
        didim.export.to_latex(robot)


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "--latex", "--robot", "planar2"]) == 0
    assert capsys.readouterr().out == didim.export.to_latex(didim.load_robot("planar2"))
    assert main(["export", "--latex", "--robot", "tx40"]) == 2
    assert "C takes any robot" in capsys.readouterr().err
