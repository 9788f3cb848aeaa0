"""Cases in which instruments help: IDIM-LS, IDIM-IV and DIDIM under wrong filters, noisy encoders and a wrong controller.

    python benches/instruments.py [--seeds N]

simulates the log of the packaged TX40 experiment with the parameters ``didim``, and prints errors in standard deviations of DIDIM
(``uncertainty = "decimated"``, no fault, rms of all seeds). The table of docs/idim_ls.md is this one.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np
from classical import off, rms

import didim
from didim.experiment.loop import closed_loop
from didim.loop.controller import Controller
from didim.studies.simulated_log import measured


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is wrong: cut-off (Hz), encoder noise and position gain over those of the simulation, and whether rows are decimated."""

    cutoff_hz: float
    encoder: float = 1.0
    gain: float = 1.0
    decimated: bool = True

    def __str__(self) -> str:
        parts = [f"{self.cutoff_hz:g} Hz" + ("" if self.decimated else ", not decimated")]
        if self.encoder != 1.0:
            parts.append(f"encoder noise x {self.encoder:g}")
        if self.gain != 1.0:
            parts.append(f"position gain x {self.gain:g}")
        return ", ".join(parts)


CASES = (
    Case(cutoff_hz=200.0),
    Case(cutoff_hz=60.0),
    Case(cutoff_hz=15.0),
    *(Case(cutoff_hz=cutoff, encoder=10.0) for cutoff in (60.0, 200.0, 450.0)),
    *(Case(cutoff_hz=cutoff, encoder=30.0) for cutoff in (60.0, 450.0)),
    Case(cutoff_hz=200.0, gain=0.7),
    Case(cutoff_hz=60.0, gain=0.7),
    Case(cutoff_hz=450.0, decimated=False),
    Case(cutoff_hz=450.0, encoder=10.0, decimated=False),
)


def logs_of(case: Case, clean: didim.Experiment, seeds: int) -> list[didim.Experiment]:
    """Logs with the noise, the filter and the controller of a case."""
    assert clean.measurement is not None
    noise = tuple(case.encoder * value for value in clean.measurement.position_noise)
    signal = replace(clean.signal, cutoff_hz=case.cutoff_hz)
    if not case.decimated:
        signal = replace(signal, decimation=(), edge_rows=0)
    experiment = replace(clean, measurement=replace(clean.measurement, position_noise=noise), signal=signal)
    if case.gain == 1.0:
        return [measured(experiment, seed) for seed in range(seeds)]
    laws = closed_loop(clean).controller.laws
    wrong = Controller.pd(case.gain * laws[:, 0], laws[:, 1])
    return [replace(measured(experiment, seed), controller=wrong) for seed in range(seeds)]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=4)
    options = parser.parse_args()
    experiment = didim.packaged_experiment("tx40")
    x = experiment.robot.parameter_set("didim")
    clean = didim.simulated_log(experiment, x, noise=False)
    truth = experiment.robot.base_parameters.project(x)
    plain = didim.DIDIM(physical=False)
    sigma = didim.identify(measured(clean, 0), replace(plain, uncertainty="decimated")).std
    print(f"{'':52}{'IDIM-LS':>9}{'IDIM-IV':>9}{'DIDIM':>9}")
    for case in CASES:
        logs = logs_of(case, clean, options.seeds)
        methods = (didim.IDIMLS(), didim.IDIMIV(), plain)
        values = [rms(np.array(off(logs, method, truth, sigma))) for method in methods]
        print(f"{case!s:52}" + "".join(f"{value:9.3g}" for value in values), flush=True)


if __name__ == "__main__":
    main()
