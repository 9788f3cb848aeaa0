"""The thresholds of the evidence: what each decides, and the logs behind it.

D of causes was chosen on 42 logs of other robots. All public logs of docs/verdict.md were looked at while size and friction were
chosen: TX40, EMPS, UR10e, UR10, KR300 and Panda; TIAGo and stretches of all chose `ROBOT`, `HEALED` and `GROWN`. So these logs only
count as examples; independent are the simulated arms of ``benches/verdicts.py``. Tested in ``tests/test_thresholds.py``.
"""

from __future__ import annotations

# Causes (`didim.evidence.causes`): D is the sum over the torque channels of log(squared error after / before).
NAMED = -1.4
"""D of the consistent fit below which a cause makes a result wrong: the error of one joint is halved and the others are
unchanged. The lowest D of a false cause on 23 good real logs is -0.78."""
HINT = -0.7
"""D of the consistent fit below which a cause is a hint."""
SCREEN = -0.35
"""D of the plain fit below which the consistent fit is computed."""
MARGIN = 0.7
"""Difference in D within which two causes explain a log alike and are named together."""
BLOCKS_BETTER = 8
"""Number of the ten blocks left out in turn that a cause must predict better."""
OTHER_LOG = -0.35
"""D on another log of the robot above which that log contradicts a cause."""
FRICTION_SIGMAS = 5.0
"""Standard deviations by which both friction parameters of a joint must be negative as declared, and positive with the other
sign."""
FRICTION_SLACK = 0.35
"""Largest D at which the sign of friction alone decides."""
NEGATIVE_SIGMAS = 3.0
"""Standard deviations of a negative friction estimate that rule out a turned sign."""
TURNED = -5.0
"""D of the consistent fit below which a turned sign needs no confirmation by the plain fit, which is blind to the signs of many
wrists."""
TORN = 0.7
"""Logarithm of a joint's squared error in the consistent fit over that in the plain one, from which its signs are doubted."""
ROBOT = 2.1
"""Sum over the channels of log(squared error of the consistent fit / of the plain one), errors below `SIZE_DOUBTFUL` counted as
that, up to which parameters of a robot explain a log: at most 1.4 on good real logs, their halves and thirds, and 8 to 18 on a
TIAGo, whatever is turned there."""
HEALED = 0.5
"""Largest share of that sum that may be left after a cause, where it is larger than `ROBOT`: beyond, something else is wrong."""
GROWN = 2.2
"""Error on blocks left out over the error in sample, beyond which a log says too little for a cause to be certain: 1.0 to 1.9 on
whole real logs, 2.6 to 10 on stretches of a few seconds, on which false causes win."""
MOST_DECIDED = 6
"""Largest number of causes for which the consistent fit is computed: the best by the plain fit."""
READ_OTHERWISE = 0.1
"""Residual, as a share of the torques, from which the verdict tests other readings of the columns, as `check` always does: a
wrong unit, side or column has a larger one, and the test takes as long as a fit."""
MOST_EXACT = 6
"""Largest number of causes with columns of their own that are fitted after the screening."""
# Friction and delays (`didim.evidence.lasting`).
FRICTION_D = -0.1
"""D on blocks left out below which a friction law, or a delay, explains something that the model lacks."""
FRICTION_EFFECT = 0.002
"""Friction of a law on blocks left out, as a share of the torque of a joint, below which it is none: torques of a controller's law
have no noise, and CLOE finds 0.03 to 0.04 % of a joint's torque in right logs of the gantry, which chose this, and 5.6 to 6.4 %
where a law is missing. On logs of the 7R, UR5e-like and iiwa14-like arms, which only counted, it is at most 0.044 % and at least
5.6 %."""
FRICTION_SHIFT = 3.0
"""Shift of a parameter by a friction law, in standard deviations, from which the intervals are too narrow."""
SMALLEST_SAMPLES = 0.2
"""Delay (samples) below which it is a difference of filters."""
DELAY_DOUBTFUL = 0.5
"""Root mean square of the shifts by a delay, in standard deviations, from which it is reported. Six logs of one arm with 1 to 2
samples have 0.6 to 1.1."""
DELAY_WRONG = 2.0
"""Root mean square of the shifts by a delay, in standard deviations, from which the parameters are not those of the robot."""

NEGLIGIBLE = 0.003
"""Error, as a share of the joint's torque, that filter and simulation explain: nothing is decided by less."""

# Size (`didim.evidence.residual`).
SIZE_DOUBTFUL = 0.05
"""Largest model error of a sound result, as a share of the torques beside white noise: EMPS has 4.1 %, UR10e 3.9 %. Also the
largest error by the uncertainty of its parameters alone, along motions of the log's size: real logs of good motions have 0.2 to
3.4 %, simulated ones at most 0.8 %, nine seconds of a KR300 10 and 28 %."""
SIZE_WRONG = 0.5
"""Model error, as a share of the torques, from which the model explains hardly anything: the worst real log of an industrial
arm has 16 %, a service robot 31 %."""
USELESS = 0.99
"""Error on blocks left out over the torques there, noise included, from which a model predicts no better than zero: random torques
have 1.0 to 1.1, the worst real log 0.5."""
SIZE_JOINT = 0.1
"""Model error, as a share of a joint's torque, from which the joint is named."""
SPIKES_SHARE = 0.01
"""Error by a torque's spikes, as a share of its standard deviation, from which they are reported."""
FEWEST_SPIKES = 1e-3
"""Smallest share of spikes among the samples: a few change no estimate."""

# Uses (`didim.evidence.uses`).
KNOWN_PERCENT = 20.0
"""Largest relative standard deviation (%) of a known parameter."""
