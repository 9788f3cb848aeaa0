"""Logs of one planar arm: with and without a payload, with offsets of their own, without noise or with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import didim
from arm import arm_log
from didim import Experiment, Recording
from didim.loop.reference import Reference
from didim.robot.payload import Payload, last_link
from didim.studies.simulated_log import simulated_log

Array = NDArray[np.float64]

DISC = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.012, 0.2, 0.05, 0.0, 0.8])
"""Ten inertial parameters of a payload of the planar arm about its flange."""


def arm_logs(
    loaded: Sequence[bool],
    *,
    offsets: Mapping[int, tuple[float, float]] | None = None,
    payloads: Mapping[str, Payload] | None = None,
    own: tuple[str, ...] = (),
    noise: Sequence[float] = (0.0, 0.0),
    seed: int = 0,
) -> Experiment:
    """One log for each entry of `loaded`, with the payload "disc" where it is True."""
    rng = np.random.default_rng(seed)
    pattern = arm_log(1)
    robot = pattern.robot
    truth = robot.parameter_set("reference")
    recordings: list[Recording] = []
    for number, with_payload in enumerate(loaded):
        x = truth + (last_link(robot, np.eye(4)) @ DISC if with_payload else 0.0)
        for joint, offset in enumerate((offsets or {}).get(number, ())):
            x[robot.parameter_names.index(f"Off{joint + 1}")] += offset
        reference = Reference.random_fourier(
            harmonics=8,
            period_s=4.0,
            max_position=[1.5, 1.5],
            max_velocity=[4.0, 5.0],
            max_acceleration=[30.0, 40.0],
            seed=10 + number,
        )
        made = simulated_log(
            replace(pattern, recordings=(), reference=reference), x, noise=False, refinement=1
        )
        (item,) = made.recordings
        assert item.tau is not None
        recordings.append(
            replace(
                item,
                name=f"log {number + 1}",
                q_ref=reference.at(item.t)[0],
                tau=item.tau + rng.standard_normal(item.tau.shape) * noise,
                payload="disc" if with_payload else "none",
                own=own,
            )
        )
    return replace(
        pattern,
        recordings=tuple(recordings),
        payloads={"disc": Payload(name="disc")} if payloads is None else payloads,
    )


def further(fit: didim.Identification) -> dict[str, float]:
    """Further parameters of a result by name."""
    assert fit.further is not None
    return fit.further.by_name
