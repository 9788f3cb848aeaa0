"""Logs without measured positions: DIDIM along the recorded reference runs, and everything else says what is missing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from didim import CLOE, DIDIM, IDIMIV, IDIMLS, Experiment, Recording, identify
from didim.cli.main import main
from didim.errors import DidimError, RecordingError
from didim.experiment.specs import ReferenceSpec

pytestmark = pytest.mark.usefixtures("without_verdict")

FILE = """schema = 1
name = "reference alone"
robot = "planar2"

[reference]
kind = "recorded"

[controller]
kind = "pd"
natural_frequency_hz = [8, 12]
damping = 0.7
inertia_of = "reference"
sample_time_s = 0.001
delay_samples = 1
velocity_fir = [0.5, 0.5]

[simulation]
smoothing_rad_s = 0.01

[[recording]]
rate_hz = 500

[recording.torque]
file = "log.csv"
columns = ["tau1", "tau2"]
unit = "N.m"
side = "joint"

[recording.reference]
file = "log.csv"
columns = ["q_ref1", "q_ref2"]
unit = "rad"
side = "joint"
"""


def arm(project: Path, *, noise: bool) -> Experiment:
    """The planar arm along its reference, with positions."""
    experiment = didim.load_experiment(project / "examples" / "planar2_simulation.toml")
    found = didim.simulated_log(experiment, experiment.robot.parameter_set("reference"), noise=noise)
    (recording,) = found.recordings
    assert isinstance(found.reference, ReferenceSpec)
    assert found.reference.made is not None
    recording = replace(recording, q_ref=found.reference.made.at(recording.t)[0])
    return replace(found, reference=ReferenceSpec("recorded", None, {}), recordings=(recording,))


def stripped(log: Experiment) -> Experiment:
    """The same log without them."""
    (recording,) = log.recordings
    without = Recording.from_arrays(None, recording.tau, rate_hz=recording.rate_hz, q_ref=recording.q_ref)
    return replace(log, recordings=(without,))


@pytest.fixture(scope="module")
def log(project: Path) -> Experiment:
    return arm(project, noise=True)


@pytest.fixture(scope="module")
def bare(log: Experiment) -> Experiment:
    return stripped(log)


def test_without_noise_the_truth_is_met(project: Path) -> None:
    fit = identify(stripped(arm(project, noise=False)), DIDIM())
    assert fit.converged
    np.testing.assert_allclose(fit.beta, fit_truth(fit), atol=1e-4)


def fit_truth(fit: didim.Identification) -> NDArray[np.float64]:
    """Base parameters of the planar arm."""
    robot = didim.load_robot("planar2")
    assert robot.base_parameters.names == fit.names
    return np.asarray(robot.set_base("reference"))


def test_didim_runs_without_positions(bare: Experiment) -> None:
    fit = identify(bare, DIDIM())
    assert fit.converged
    assert np.max(np.abs(fit.beta - fit_truth(fit)) / fit.std) < 3.5
    (found,) = didim.validate(fit, bare).recordings
    assert found.direct is None
    assert set(found.simulated) == {"torque"}
    assert np.max(found.simulated["torque"]) < 0.02
    assert "torque, simulated" in str(didim.validate(fit, bare))


@pytest.mark.parametrize(
    "call",
    [
        lambda log: identify(log, IDIMLS()),
        lambda log: identify(log, IDIMIV()),
        lambda log: identify(log, CLOE(start="reference")),
        lambda log: identify(log, DIDIM(compensate_samples="estimate")),
        didim.check,
        lambda log: identify(replace(log, reference=ReferenceSpec("measured", None, {})), DIDIM()),
    ],
    ids=["idim-ls", "idim-iv", "cloe", "delay", "check", "measured reference"],
)
def test_all_else_names_what_is_missing(bare: Experiment, call: Callable[[Experiment], object]) -> None:
    with pytest.raises(
        DidimError, match=r"recording 'recording' has no measured positions .* only DIDIM"
    ) as told:
        call(bare)
    assert "\n" not in str(told.value)


def test_a_log_needs_positions_or_reference_positions() -> None:
    with pytest.raises(RecordingError, match="give q, or q_ref"):
        Recording.from_arrays(None, np.zeros((20, 2)), rate_hz=100.0)
    with pytest.raises(RecordingError, match="there must be reference positions"):
        Recording(t=np.arange(20) / 100.0, q=np.zeros((20, 2)), rate_hz=100.0, has_positions=False)


@pytest.mark.usefixtures("without_drawing")
def test_an_experiment_file_without_positions(
    log: Experiment, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording,) = log.recordings
    assert recording.q_ref is not None
    assert recording.tau is not None
    np.savetxt(
        tmp_path / "log.csv",
        np.hstack([recording.tau, recording.q_ref]),
        delimiter=",",
        header="tau1,tau2,q_ref1,q_ref2",
        comments="",
        fmt="%.17g",
    )
    path = tmp_path / "log.toml"
    path.write_text(FILE)
    report = tmp_path / "fit.html"
    assert main(["identify", str(path), "--method", "didim", "--report", str(report)]) == 0
    assert "Converged" in capsys.readouterr().out
    assert report.is_file()
    assert main(["identify", str(path)]) == 2
    assert "has no measured positions" in capsys.readouterr().err
    assert main(["check", str(path)]) == 2
    assert "has no measured positions" in capsys.readouterr().err
    path.write_text(FILE[: FILE.index("[recording.reference]")])
    assert main(["check", str(path)]) == 2
    assert "[recording.position] is missing" in capsys.readouterr().err
