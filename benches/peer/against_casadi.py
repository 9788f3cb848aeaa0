"""C code that CasADi generates for the forward dynamics of the TX40.

Rigid-body recursions written with CasADi's scalar symbols over the MDH rows: bias torques by Newton-Euler, M(q) by composite
bodies, ``M ddq = tau - bias`` by an unrolled L D L^T. Zeros and ones of right angles and the parameters are constants of
the code, which suits the peer: nothing of them is left to compute. A loop in C calls it, so that Python costs nothing.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim

from .task import SAMPLES, Task, bodies
from .timing import Contestant, MissingError, per_unit

Array = NDArray[np.float64]

COMPILER = "gcc"
FLAGS = ("-O3", "-march=native", "-fPIC", "-shared")

LOOP = """
#include "forward.c"
void batch(long n, const double* q, const double* dq, const double* tau, double* ddq) {
    casadi_int iw[forward_SZ_IW + 1];
    casadi_real w[forward_SZ_W + 1];
    for (long k = 0; k < n; ++k) {
        const casadi_real* in[] = {q + 6 * k, dq + 6 * k, tau + 6 * k};
        casadi_real* out[] = {ddq + 6 * k};
        forward(in, out, iw, w, 0);
    }
}
"""


def contestants(task: Task, rounds: int) -> list[Contestant]:
    """Forward dynamics of a batch, after a check against ours."""
    batch, _ = compiled(task)
    out = np.empty((SAMPLES, 6))
    batch(task.q, task.dq, task.tau, out)
    ours = didim.direct_dynamics(task.plain, task.q, task.dq, task.tau, task.free)
    task.check("CasADi's code", "the forward dynamics", out, ours)
    run = per_unit(lambda: batch(task.q, task.dq, task.tau, out), SAMPLES)
    return [Contestant(name="CasADi's C, forward dynamics", measure=run, unit="us", rounds=rounds)]


def versions() -> dict[str, str]:
    """CasADi's version and the compiler's."""
    compiler = subprocess.run([COMPILER, "--version"], capture_output=True, text=True, check=True)
    return {"casadi": version("casadi"), COMPILER: f"{compiler.stdout.splitlines()[0]}, {' '.join(FLAGS)}"}


def compiled(task: Task) -> tuple[Callable[[Array, Array, Array, Array], None], int]:
    """Return the forward dynamics as a function of C-ordered arrays q, dq, tau and the output, and its number of operations."""
    try:
        import casadi
    except ImportError:
        raise MissingError("CasADi is not installed (pip install casadi).") from None
    if shutil.which(COMPILER) is None:
        raise MissingError(f"there is no {COMPILER} to compile CasADi's code with.")
    q, dq, tau = (casadi.SX.sym(name, 6) for name in ("q", "dq", "tau"))
    function = casadi.Function(
        "forward", [q, dq, tau], [casadi.cse(forward_dynamics(casadi, task, q, dq, tau))]
    )
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
        generator = casadi.CodeGenerator("forward.c", {"with_mem": False})
        generator.add(function)
        generator.generate(f"{where}/")
        sizes = f"#define forward_SZ_IW {function.sz_iw()}\n#define forward_SZ_W {function.sz_w()}\n"
        (where / "loop.c").write_text(sizes + LOOP, encoding="ascii")
        library = where / "forward.so"
        subprocess.run([COMPILER, *FLAGS, "-o", str(library), str(where / "loop.c"), "-lm"], check=True)
        code = ctypes.CDLL(str(library))
    pointer = np.ctypeslib.ndpointer(np.float64, ndim=2, flags="C_CONTIGUOUS")
    code.batch.argtypes = [ctypes.c_long, pointer, pointer, pointer, pointer]
    code.batch.restype = None

    def batch(q: Array, dq: Array, tau: Array, out: Array) -> None:
        code.batch(len(q), q, dq, tau, out)

    return batch, function.n_instructions()


def forward_dynamics(casadi: Any, task: Task, q: Any, dq: Any, tau: Any) -> Any:
    """Accelerations of links and rotors as expressions."""
    geometry = task.plain.geometry
    if set(geometry.kinds) != {"revolute"}:
        raise MissingError("CasADi's script knows revolute joints alone.")
    links, rotors = bodies(task), task.rotors
    n = len(links)
    rotations, places = [], []
    for j in range(n):
        fixed = _clean(_about("x", geometry.alpha[j]) @ _about("z", geometry.theta[j]))
        c, s = casadi.cos(q[j]), casadi.sin(q[j])
        turn = casadi.SX(3, 3)
        turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1], turn[2, 2] = c, -s, s, c, 1.0
        rotations.append(casadi.mtimes(_sparse(casadi, fixed), turn))
        places.append(
            _sparse(
                casadi,
                _clean(
                    np.array([geometry.d[j], 0.0, 0.0]) + geometry.r[j] * _about("x", geometry.alpha[j])[:, 2]
                ),
            )
        )

    def mul(a: Any, b: Any) -> Any:
        return casadi.mtimes(a, b)

    def skew(v: Any) -> Any:
        return casadi.sparsify(casadi.skew(v))

    masses = [m for m, _, _ in links]
    moments = [_sparse(casadi, m * c) for m, c, _ in links]
    inertias = [_sparse(casadi, inertia) for _, _, inertia in links]

    # Newton-Euler with ddq = 0: the base is accelerated upwards in place of gravity.
    w, dw, a = casadi.SX(3, 1), casadi.SX(3, 1), _sparse(casadi, -np.array(geometry.gravity))
    forces, torques = [], []
    for j in range(n):
        inwards = rotations[j].T
        a = mul(inwards, a + mul(skew(dw), places[j]) + mul(skew(w), mul(skew(w), places[j])))
        axis = casadi.SX(3, 1)
        axis[2] = dq[j]
        w, dw = mul(inwards, w), mul(inwards, dw)
        dw = dw + mul(skew(w), axis)
        w = w + axis
        forces.append(masses[j] * a + mul(skew(dw), moments[j]) + mul(skew(w), mul(skew(w), moments[j])))
        torques.append(mul(inertias[j], dw) + mul(skew(w), mul(inertias[j], w)) + mul(skew(moments[j]), a))
    bias = casadi.SX(n, 1)
    for j in reversed(range(n)):
        bias[j] = torques[j][2]
        if j:
            force = mul(rotations[j], forces[j])
            forces[j - 1] = forces[j - 1] + force
            torques[j - 1] = torques[j - 1] + mul(rotations[j], torques[j]) + mul(skew(places[j]), force)

    # Composite bodies, about the origin of the frame of their first link.
    matrix = casadi.SX(n, n)
    for j in reversed(range(n)):
        moment = inertias[j][:, 2]
        force = mul(skew(_sparse(casadi, np.array([0.0, 0.0, 1.0]))), moments[j])
        matrix[j, j] = moment[2] + rotors[j]
        for k in reversed(range(j)):
            force = mul(rotations[k + 1], force)
            moment = mul(rotations[k + 1], moment) + mul(skew(places[k + 1]), force)
            matrix[j, k] = moment[2]
        if j:
            arm, turned = skew(places[j]), skew(mul(rotations[j], moments[j]))
            inertia = mul(mul(rotations[j], inertias[j]), rotations[j].T)
            inertia = inertia - mul(turned, arm) - mul(arm, turned) - masses[j] * mul(arm, arm)
            inertias[j - 1] = inertias[j - 1] + inertia
            moments[j - 1] = moments[j - 1] + mul(rotations[j], moments[j]) + masses[j] * places[j]
            masses[j - 1] = masses[j - 1] + masses[j]
    return _solved(casadi, matrix, tau - bias)


def _solved(casadi: Any, matrix: Any, right: Any) -> Any:
    """Solve with the lower half of a symmetric matrix by L D L^T, unrolled."""
    n = right.shape[0]
    lower = [[casadi.SX(0)] * n for _ in range(n)]
    pivots: list[Any] = []
    for j in range(n):
        scaled = [lower[j][k] * pivots[k] for k in range(j)]
        pivots.append(matrix[j, j] - sum(lower[j][k] * scaled[k] for k in range(j)))
        for i in range(j + 1, n):
            lower[i][j] = (matrix[i, j] - sum(lower[i][k] * scaled[k] for k in range(j))) / pivots[j]
    y: list[Any] = []
    for i in range(n):
        y.append(right[i] - sum(lower[i][k] * y[k] for k in range(i)))
    x: list[Any] = [value / pivot for value, pivot in zip(y, pivots, strict=True)]
    for i in reversed(range(n)):
        x[i] = x[i] - sum(lower[k][i] * x[k] for k in range(i + 1, n))
    return casadi.vertcat(*x)


def _about(axis: str, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    if axis == "x":
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _clean(values: Array) -> Array:
    """Zero in place of what a right angle leaves, 6e-17."""
    return np.where(np.abs(values) < 1e-15, 0.0, values)


def _sparse(casadi: Any, values: Array) -> Any:
    """Return constants whose zeros are known."""
    return casadi.sparsify(casadi.SX(casadi.DM(values)))
