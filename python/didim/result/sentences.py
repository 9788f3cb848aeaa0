"""Sentences and advice of findings; those of causes are in ``words/causes.py``.

A finding with its own sentence (a status, a remark, a flag on physics) has it as ``facts["text"]`` and ``facts["advice"]``.
Tested in ``tests/test_verdict.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from .._tools.words import joints_text, series
from .words.applied import WORDS as APPLIED
from .words.applied import larger, larger_advice
from .words.causes import CAUSES, edit, looks

Finding = Any
"""The class of `didim.result.finding`, which imports this module."""


def sentence_of(finding: Finding) -> str:
    """Return observation, location and size; without a full stop."""
    if "text" in finding.facts:
        return str(finding.facts["text"])
    if finding.code in CAUSES and "left" in finding.facts:
        facts = finding.facts
        first = looks(finding.code, finding.joints, finding.value, facts)
        text = f"{first}{' (or another cause)' if facts['ties'] else ''}"
        if facts.get("friction"):
            named = series((f"{name} = {value:.3g}" for name, value in facts["friction"].items()), 40)
            return f"{text}: friction would drive the robot ({named})"
        return (
            f"{text}: corrected, {percent(facts['left'])} % of the error remain (geometric mean; {facts['blocks']} of 10 held-out "
            "blocks get better)"
        )
    return WORDS[finding.code][0](finding)


def advice_of(finding: Finding) -> str:
    """Return the advice; empty if no action is needed."""
    if "text" in finding.facts:
        return str(finding.facts.get("advice", ""))
    if finding.code in CAUSES and "left" in finding.facts:
        facts = finding.facts
        first = edit(finding.code, finding.joints, finding.value, facts)
        ties = [looks(tie["code"], tuple(tie["joints"]), tie["value"], tie["facts"]) for tie in facts["ties"]]
        decide = f"What would decide: {CAUSES[finding.code][2]}"
        if ties:
            return ". ".join([first, *(f"Or {text}: this log does not show which" for text in ties), decide])
        return first if finding.grade == "wrong" else f"{first}. {decide}"
    advice = WORDS[finding.code][1]
    return advice if isinstance(advice, str) else advice(finding)


def between(values: Sequence[float], digits: str = ".2g") -> str:
    """Return the smallest and the largest of some numbers as text, or one number if they are equal."""
    low, high = (format(value, digits) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def two_digits(value: float) -> str:
    """Return a number with two digits, from 100 on with all before the point."""
    return f"{value:.2g}" if abs(value) < 99.5 else f"{value:.0f}"


def percent(share: float) -> str:
    """Return a share in percent as text."""
    return two_digits(100.0 * share)


def percents(shares: Sequence[float]) -> str:
    """Return the smallest and the largest of some shares in percent, or one number if they are equal."""
    low, high = percent(min(shares)), percent(max(shares))
    return low if low == high else f"{low} to {high}"


def _joints(finding: Finding) -> str:
    return joints_text(joint - 1 for joint in finding.joints)


# All other findings: (sentence, advice).


def _not_white(f: Finding) -> str:
    facts = f.facts
    text = (
        f"the residual of {_joints(f)}, {percents(facts['shares'])} % of the torque, is correlated in time: white-noise sigmas "
        f"would be {between(facts['growth'])} times too small"
    )
    if facts.get("jackknife") is not None:
        text += f"; the jackknife sigmas shown include a factor of {facts['jackknife']:.2g}"
    return text


def _simulated_motion(f: Finding) -> str:
    return (
        f"the simulated motion of {_joints(f)} misses {percents(f.facts['missed'])} % of the measured motion, and that of a "
        "right closed loop 0.1 % or less"
    )


def _simulated_motion_advice(f: Finding) -> str:
    return {
        "made-up": "The controller is made up: raise its natural_frequency_hz, or trust IDIM-LS",
        "measured": "The reference is the measured position: log the real one, or trust IDIM-LS",
    }.get(f.facts["loop"], "Look at [controller] and [reference]; until then trust IDIM-LS")


def _left(f: Finding) -> str:
    facts = f.facts
    return (
        f"the declared controller leaves {percent(facts['worst'])} % of the torque of joint {facts['joint']}"
    )


def _law(f: Finding, text: str) -> str:
    return f"{text}: {_left(f)}, and this {percent(f.facts['left'])} % of that"


def _controller_gain(f: Finding) -> str:
    parts = [
        f"{joint['name']} of {joints_text(j - 1 for j in joint['joints'])} is {between(joint['values'], '.3g')} times the "
        "declared one"
        for joint in f.facts["gains"]
    ]
    return _law(f, "the log's controller has other gains: " + (series(parts, 80) or "several differ"))


def _saturation(f: Finding) -> str:
    limits = series((f"{value:.3g}" for value in f.facts["limits"]), 40)
    return _law(f, f"the torque of {_joints(f)} is limited to {limits} (N.m or N), which is not declared")


def _value(f: Finding) -> float:
    return 0.0 if f.value is None else f.value


def _held_out(f: Finding) -> str:
    if "applied" in f.facts:
        return larger(f)
    return (
        f"on recording '{f.recordings[0]}', which was held out, the torques of {_joints(f)} are off by "
        f"{percent(f.facts['share'])} %, {between(f.facts['ratios'])} times as much as on the recordings of the fit"
    )


def _delay(f: Finding) -> str:
    which = f"torque of {_joints(f)} looks" if f.joints else "torques look"
    if "gain" in f.facts:  # estimated joint by joint
        effect = f": corrected, the residual is {percent(f.facts['gain'])} % smaller"
    else:
        effect = f", which moves parameters by {two_digits(f.effect)} sigma rms"
    return (
        f"the {which} {abs(_value(f)):.2g} samples ({1e3 * f.facts['seconds']:.2g} ms) "
        f"{'behind' if _value(f) > 0.0 else 'ahead of'} the motion{effect}"
        + ("; a digital hold leaves half of one" if f.facts.get("held") else "")
    )


def _delay_advice(f: Finding) -> str:
    key = 'compensate_samples = "estimate"'
    if "samples" in f.facts:
        key = f'compensate_samples = {f.facts["samples"]} or "estimate"'
    return (
        f"Write {'sample_time_s under [controller], or ' if f.facts.get('held') else ''}{key} under [delay]"
    )


LAWS = {
    "asymmetric": "differs by direction",
    "stribeck": "falls with speed (Stribeck)",
    "atan": "bends with speed (arctangent)",
    "load": "grows with the load",
    "dahl": "has a memory (Dahl)",
}
"""Description of friction laws that a model may lack."""
MISSING = {
    "asymmetric": "friction of each direction",
    "stribeck": "Stribeck's law",
    "atan": "an arctangent",
    "load": "load friction",
    "dahl": "Dahl's memory",
}
"""Names of these laws."""
MOST_NAMED = 110
"""Largest number of characters of the laws that a sentence names."""


def _friction(f: Finding) -> str:
    facts = f.facts
    included = "intervals include it" if facts["included"] else "intervals are too narrow"
    # Results of version 0.3.0 name one law for all joints.
    laws = facts.get("laws", {})
    if facts.get("refused"):
        seen = f"the residual of {_joints(f)} looks like further friction"
        return f"{seen}, but blocks left out support no further law; {included}"
    if len(laws) < 2:
        law = next(iter(laws), facts["law"])
        return (
            f"the friction of {_joints(f)} {LAWS[law]}, not modelled: parameters move by up to "
            f"{two_digits(f.effect)} sigma of noise; {included}"
        )
    named = (f"{MISSING[law]} at {joints_text(j - 1 for j in joints)}" for law, joints in laws.items())
    return f"friction lacks {series(named, MOST_NAMED)}: parameters move up to {two_digits(f.effect)} sigma; {included}"


def _friction_advice(f: Finding) -> str:
    law = f.facts["law"]
    if f.facts.get("refused"):
        return ""
    if f.facts.get("add"):
        added = (f"{joints_text(j - 1 for j in joints)} to {key}" for key, joints in f.facts["add"].items())
        return f"Add {series(added, MOST_NAMED)} under [friction]: blocks left out support it"
    if law == "asymmetric":
        return 'Write model = "asymmetric" under [friction]'
    terms = 'stribeck = true or terms = "auto"' if law == "stribeck" else 'terms = "auto"'
    smooth = "" if f.facts["smooth"] else '; coulomb = "tanh" if a simulator made the log'
    return f"Write {terms} under [friction]{smooth}"


def _model_error(f: Finding) -> str:
    return (
        f"the errors of {_joints(f)} are up to {_value(f):.2g} times the noise: the model is not exact; intervals "
        + (
            "include what another law of friction changes, but no other error"
            if f.facts["widened"]
            else "hold for its law of friction alone, so they are too narrow"
        )
    )


def _held(f: Finding) -> str:
    limits, times, pushed = f.facts["limits"], f.facts["times"], f.facts["pushed"]
    ends = series((f"{limit:.3g}" for limit in limits), 16)
    by = [
        *([f"the end of its range ({ends})"] if limits else []),
        *(["a contact"] if f.facts["contact"] else []),
    ]
    longest = max(range(len(times)), key=lambda k: times[k][1] - times[k][0])
    begin, end = times[longest]
    of = f" of '{f.facts['of'][longest]}'" if f.facts["of"] else ""
    others = f" and {len(times) - 1} more times" if len(times) > 1 else ""
    when = f"from {begin:.2f} to {end:.2f} s{of}{others} ({_value(f):.3g} s)"
    if pushed:
        return f"something pushes {f.facts['name']} or its errors have another cause {when}: its limb is left out"
    return f"{f.facts['name']} is held by {' or '.join(by)} {when}: its limb is left out"


def _size(f: Finding) -> str:
    of = "the torques of the servos" if f.facts.get("positions") else "held-out torques, without their noise"
    return (
        f"the model misses {percent(_value(f))} % of {of}"
        + (f", most in {_joints(f)} ({percents(f.facts['shares'])} %)" if f.joints else "")
        + f", and a result is sound up to {percent(f.facts['limit'])} %"
    )


_LACKS = "look for what the model lacks (elasticity, a counterbalance, cross-talk)"


def _uncertain(f: Finding) -> str:
    return (
        f"along motions like those of the log the uncertainty of the parameters alone makes {percent(_value(f))} % of the "
        f"torques (sound: up to {percent(f.facts['limit'])} %): {f.facts['count']} of {f.facts['of']} parameters are known to no "
        "better than 20 %"
    )


def _constant_torque(f: Finding) -> str:
    if "means" in f.facts:
        means = series((f"{value:.3g}" for value in f.facts["means"]), 30)
        return f"the torque of {_joints(f)} is noise about a constant ({means}) though the joint moves"
    numbers = f.facts["numbers"]
    which = joints_text(number - 1 for number in numbers).replace("joint", f.facts["side"])
    torques = f"torque of {which} is" if len(numbers) == 1 else f"torques of {which} are"
    column = f.facts.get("column")
    where = (
        "" if column is None else f" (column{'s' if len(numbers) > 1 else ''} {column} of {f.facts['file']})"
    )
    return f"recording '{f.recordings[0]}': the {torques} constant in all {f.facts['samples']} samples{where}"


def _gain_unchecked(f: Finding) -> str:
    one = len(f.joints) == 1
    shares = series((f"{100.0 * share:.2g}" for share in f.facts["shares"]), 12)
    return (
        f"the drive gain{'' if one else 's'} of {_joints(f)} cannot be checked by this log: only {shares} % of the torque "
        "depends on parameters that other joints determine"
    )


def _contradiction(f: Finding) -> str:
    facts = f.facts
    free, held = (f"{percent(facts[key])} %" for key in ("plain", "constrained"))
    if f.grade == "wrong":
        return (
            f"no robot explains these torques: physically consistent parameters miss {held} of them, others {free}; check gravity, "
            "the mounting of the robot and the unit of the torques"
        )
    return (
        f"physical conditions raise the residual from {free} to {held}: the model or the log is wrong; check the signs of the "
        "torques, gravity and the friction model"
    )


def _drift(f: Finding) -> str:
    worst = (
        f"most by {_value(f):.3g} +- {f.deviation:.2g} in {f.facts['parameter']} of '{f.facts['recording']}'"
    )
    if f.facts["of"] == "offset":
        return f"the offsets of {_joints(f)} differ between recordings, {worst}"
    texts = []
    for level in f.facts["levels"]:
        share, sigmas = level["share"], abs(level["share"]) / level["std"]
        change = f"{percent(abs(share))} % {'higher' if share > 0.0 else 'lower'}"
        texts.append(
            f"{level['recording']}: joint {level['joint']} {change}, {sigmas:.{int(sigmas < 9.95)}f} sigma"
        )
    return f"friction differs from the first recording ({series(texts, 80)}): warmer, or loaded? {worst[0].upper()}{worst[1:]}"


def _drift_advice(f: Finding) -> str:
    return f'Give the recordings {"offsets" if f.facts["of"] == "offset" else "friction"} = "own"'


Words = tuple[Callable[[Finding], str], str | Callable[[Finding], str]]
"""Function that writes the sentence of a finding, and its advice or the function that writes it."""
WORDS: dict[str, Words] = {
    "no-robot": (_contradiction, ""),
    "not-white": (
        _not_white,
        lambda f: (
            ""
            if f.grade == "note"
            else 'The model lacks something: try terms = "auto" under [friction], and run didim check'
        ),
    ),
    "simulated-motion": (_simulated_motion, _simulated_motion_advice),
    "torque-slope": (
        lambda f: (
            f"the measured torques of {_joints(f)} are {between(f.facts['slopes'], '.3f')} times those of the simulated robot "
            f"(+- {f.deviation:.1g})"
        ),
        "The parameters are off by as much: look at the gains of [controller], and at the drive gains",
    ),
    "worse-than-idim-ls": (
        lambda f: (
            f"the simulated torques of {_joints(f)} are off by {percents(f.facts['own'])} %, and IDIM-LS leaves "
            f"{percents(f.facts['least'])} % on the same rows"
        ),
        "The robot's model is not the cause: look at [controller] and [reference], and trust IDIM-LS",
    ),
    "held-out": (
        _held_out,
        lambda f: (
            larger_advice(f)
            if "applied" in f.facts
            else "The logs differ (load, temperature, friction), or the fit lacks motion that this one has"
        ),
    ),
    "controller": (
        lambda f: (
            f"{_left(f)}, and no other gain, delay, limit or feed-forward explains it"
            if "worst" in f.facts
            else f"with these parameters the robot does not follow: its torques are off by {percent(_value(f))} %"
        ),
        lambda f: (
            "Look at kind, gains and units of [controller], and at [reference]; until then trust IDIM-LS"
            if "worst" in f.facts
            else "Check the controller, start elsewhere"
            + ("" if f.facts["updating"] else ", or let gain_updating be 'first'")
        ),
    ),
    "controller-gain": (_controller_gain, "Correct the gains under [controller]"),
    "controller-delay": (
        lambda f: _law(
            f,
            f"the log's controller acts {1e3 * abs(_value(f)):.3g} ms {'later' if _value(f) >= 0.0 else 'earlier'} than the "
            "declared one",
        ),
        "Write sample_time_s and delay_samples under [controller]",
    ),
    "reference-late": (
        lambda f: _law(
            f,
            f"the reference looks {1e3 * abs(_value(f)):.3g} ms {'late' if _value(f) > 0.0 else 'early'} against the positions",
        ),
        "Log the reference that the controller gets, at the same time",
    ),
    "saturation": (_saturation, "Write saturation under [controller]"),
    "feed-forward": (
        lambda f: _law(
            f,
            f"the log's controller feeds a torque forward, {_value(f):.2g} times that of the model along the reference",
        ),
        "Declare it under [controller], or log it",
    ),
    "delay": (_delay, _delay_advice),
    "drift": (_drift, _drift_advice),
    "friction": (_friction, _friction_advice),
    "model-error": (
        _model_error,
        "Look for what the model lacks, and compare with another log (didim validate)",
    ),
    "held": (_held, ""),
    "size": (
        _size,
        lambda f: (
            f"{_LACKS[0].upper()}{_LACKS[1:]}"
            if f.facts.get("chosen") or f.facts.get("positions")
            else f'Try terms = "auto" under [friction]; {_LACKS}'
        ),
    ),
    "unidentified": (
        _uncertain,
        "Record a richer or longer motion, drop parameters under [parameters], or write physical = true under [least_squares]",
    ),
    "constant-torque": (_constant_torque, "Look at the sensor and at columns under [recording.torque]"),
    "spikes": (
        lambda f: (
            f"{f.facts['count']} samples of the torques of {_joints(f)} ({percent(_value(f))} %) are isolated, far from their "
            "neighbours"
        ),
        'Write spikes = "hampel" under [signal], which replaces them before the decimation smears them',
    ),
    "gain-unchecked": (_gain_unchecked, ""),
    **APPLIED,
}
"""Sentence and advice of the other findings, by code."""
