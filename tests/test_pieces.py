"""A log read in pieces gives the rows, and so the estimate, of the log as a whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import didim
from didim.errors import DidimError, RecordingError
from didim.log.formats import text_rows
from didim.log.formats.text_rows import TextRows
from didim.methods.idim_ls import IDIMLS
from didim.methods.pieces import fold_log
from didim.result.iteration import Reporter

RATE_HZ = 500.0
FILE = """\
schema = 1
name = "long"
robot = "planar2"
[[recording]]
rate_hz = 500
position = { file = "log.csv", columns = ["q1", "q2"], unit = "rad", side = "joint" }
torque = { file = "log.csv", columns = ["tau1", "tau2"], unit = "N.m", side = "joint" }
[signal]
cutoff_hz = 40
decimation = [4, 5]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty seconds of a planar arm with noise, 10 007 rows."""
    robot, rng = didim.load_robot("planar2"), np.random.default_rng(0)
    t = np.arange(10_007)[:, None] / RATE_HZ
    omega, phase = 2.0 * np.pi * rng.uniform(0.2, 1.2, (2, 5, 1, 2))
    q = np.sum(0.3 * np.sin(omega * t + phase), axis=0)
    dq = np.sum(0.3 * omega * np.cos(omega * t + phase), axis=0)
    ddq = np.sum(-0.3 * omega**2 * np.sin(omega * t + phase), axis=0)
    tau = didim.inverse_dynamics(robot, q, dq, ddq, robot.parameter_set("reference"))
    tau += rng.standard_normal(tau.shape) * [0.5, 0.1]
    q += 1e-5 * rng.standard_normal(q.shape)
    place = tmp_path_factory.mktemp("long")
    np.savetxt(
        place / "log.csv",
        np.column_stack([t, q, tau]),
        fmt="%.9g",
        delimiter=",",
        header="t,q1,q2,tau1,tau2",
        comments="",
    )
    return place


def written(folder: Path, text: str) -> Path:
    (folder / "long.toml").write_text(text, encoding="utf-8")
    return folder / "long.toml"


@pytest.mark.parametrize(
    "more",
    [
        "",
        'decimation_convention = "matlab"\npadding = "matlab"\nends = "first-order"\n',
        "trim_start = 33\nedge_rows = 0\n[delay]\ncompensate_samples = [2.4, -1.0]\n",
        "[parameters]\ndropped = ['Off2']\nfixed = { Fv1 = 2.0 }\n",
    ],
)
@pytest.mark.parametrize("windows", ["", "windows_s = [[0.5, 7.1], [7.5, 19.002]]\n"])
def test_the_estimate_is_that_of_the_whole_log(folder: Path, more: str, windows: str) -> None:
    text = FILE.replace("rate_hz = 500\n", "rate_hz = 500\n" + windows) + more
    path = written(folder, text)
    whole = IDIMLS(uncertainty="white").run(didim.load_experiment(path), Reporter())
    recursive = fold_log(path, rows=1500)
    found = recursive.estimate()
    assert recursive.n_rows * 2 == whole.n_rows
    np.testing.assert_allclose(found.beta, whole.beta, rtol=1e-9, atol=1e-10)
    if not whole.settings["fixed"]:  # their torques are not in those of the triangles
        np.testing.assert_allclose(found.relative_error, whole.relative_error, rtol=1e-9)


def test_time_stamps_give_the_rate_of_every_piece(folder: Path) -> None:
    stamps = 'time = { file = "log.csv", columns = ["t"] }'
    found = fold_log(written(folder, FILE.replace("rate_hz = 500", stamps)), rows=1500).estimate()
    same = fold_log(written(folder, FILE)).estimate()
    np.testing.assert_allclose(found.beta, same.beta, rtol=1e-7, atol=1e-8)


def test_a_wrong_row_is_named_from_the_first_of_its_piece(folder: Path, tmp_path: Path) -> None:
    lines = (folder / "log.csv").read_text().splitlines()
    lines[9001] = lines[9001].replace(",", ",x", 1)
    (tmp_path / "log.csv").write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"^log.csv after row (\d+): row (\d+) ") as error:
        fold_log(written(tmp_path, FILE.replace("[4, 5]", "[2]")), rows=1500)
    numbers = [int(word) for word in str(error.value).replace(":", " ").split() if word.isdigit()]
    assert sum(numbers[:2]) == 9001


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("rate_hz = 500", 'rollouts = "gaps"\nrate_hz = 500', "need the whole log"),
        ("[signal]", '[delay]\ncompensate_samples = "estimate"\n[signal]', "give compensate_samples"),
        ("[signal]", '[friction]\nterms = "auto"\n[signal]', "need the whole log"),
        ("log.csv", "log.npz", "only text files are read in pieces"),
        ('"log.csv", columns = ["q1", "q2"]', '["a.csv", "b.csv"]', "a file for each column"),
    ],
)
def test_what_needs_the_whole_log_is_refused(folder: Path, old: str, new: str, sentence: str) -> None:
    with pytest.raises(DidimError, match=sentence):
        fold_log(written(folder, FILE.replace(old, new)))


@pytest.mark.parametrize("header", ["", "a,b\n"])
@pytest.mark.parametrize("end", ["", "\n", "\r\n\r\n \n"])
def test_ranges_of_rows_are_those_of_the_file(
    header: str, end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text_rows, "EVERY", 4)
    monkeypatch.setattr(text_rows, "BLOCK", 1)
    numbers = np.arange(74.0).reshape(37, 2)
    path = tmp_path / "log.csv"
    path.write_bytes((header + "\n".join(f"{a},{b}" for a, b in numbers.tolist()) + end).encode())
    file = TextRows(path, "log.csv", None, None, None)
    assert file.count == 37
    for start, stop in ((0, 37), (0, 1), (3, 4), (4, 8), (5, 23), (31, 37), (36, 37)):
        np.testing.assert_array_equal(file.rows(start, stop).get(None, None, 2), numbers[start:stop])
