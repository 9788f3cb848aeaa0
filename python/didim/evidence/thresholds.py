"""The thresholds of the evidence: what each decides, and the logs behind it.

Chosen on the first half of the logs that docs/verdict.md lists, and only counted on the second.
Tested in ``tests/test_turning_points.py``.
"""

from __future__ import annotations

# Causes (`didim.evidence.causes`): D is the sum over the torque channels of log(squared error after / before).
NAMED = -1.4
"""D of the consistent fit from which a cause makes a result wrong: the error of one joint is halved and the others keep theirs. The
lowest D of a false cause on 23 good real logs is -0.78."""
HINT = -0.7
"""D of the consistent fit from which a cause is a hint."""
SCREEN = -0.35
"""D of the plain fit from which the consistent fit is asked."""
MARGIN = 0.7
"""D within which two causes explain a log alike, and are named together."""
BLOCKS_BETTER = 8
"""Blocks of ten, left out in turn, that a cause must predict better."""
OTHER_LOG = -0.35
"""D on another log of the robot above which that log contradicts a cause."""
FRICTION_SIGMAS = 5.0
"""Standard deviations by which both friction parameters of a joint would drive it as declared, and brake it with another sign."""
FRICTION_SLACK = 0.35
"""D up to which the sign of friction speaks alone."""
NEGATIVE_SIGMAS = 3.0
"""Standard deviations of negative friction that a turned sign must not bring."""
TURNED = -5.0
"""D of the consistent fit from which a turned sign needs no confirmation by the plain fit, which is blind to the signs of many
wrists."""
TORN = 0.7
"""Logarithm of a joint's squared error of the consistent fit over that of the plain one, from which its signs are doubted."""
MOST_DECIDED = 6
"""Causes that the consistent fit is asked for at most: the best by the plain fit."""
READ_OTHERWISE = 0.1
"""Share of the torques left from which the verdict asks, as `check` always does, whether columns are to be read otherwise: a wrong
unit, side or column leaves more, and the look takes as long as a fit."""
MOST_EXACT = 6
"""Causes with columns of their own that are fitted after the rougher look at most."""
# Friction and delays (`didim.evidence.lasting`).
FRICTION_D = -0.1
"""D on blocks left out from which a friction law, or a delay, explains something that the model lacks."""
FRICTION_SHIFT = 3.0
"""Standard deviations by which a parameter must move with a friction law for the intervals to be too narrow."""
SMALLEST_SAMPLES = 0.2
"""Delays (samples) below it are differences of filters."""
DELAY_DOUBTFUL = 0.5
"""Root mean square of the shifts, in standard deviations, from which a delay is worth a finding. Six logs of one arm with 1 to 2
samples have 0.6 to 1.1."""
DELAY_WRONG = 2.0
"""Root mean square of the shifts, in standard deviations, from which the parameters are not those of the robot."""

# Size (`didim.evidence.residual`).
SIZE_DOUBTFUL = 0.05
"""Share of the torques, beside white noise, that the model may miss in a sound result: EMPS 4.1 %, UR10e 3.9 %."""
SIZE_WRONG = 0.5
"""Share from which the model explains hardly anything: the worst real log of an industrial arm has 16 %, a service robot 31 %."""
SIZE_JOINT = 0.1
"""Share of a joint's torque from which it is named."""
SPIKES_SHARE = 0.01
"""Error of the spikes of a torque over its standard deviation from which they are reported."""
FEWEST_SPIKES = 1e-3
"""Share of samples that are spikes at least: a few change no estimate."""

# Uses (`didim.evidence.uses`).
UNTOLD = 0.3
"""Share of the torques, along random motions of the log's size, that the uncertainty of the parameters alone may make."""
KNOWN_PERCENT = 20.0
"""Relative standard deviation (%) to which a parameter counts as known."""
