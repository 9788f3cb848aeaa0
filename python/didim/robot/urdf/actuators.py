"""Actuators of an MJCF: gains and limits of ``position``, ``velocity``, ``motor`` and ``general``, on the joint's side of the gear.

All kinds of one class share their defaults, as in MuJoCo: a shortcut is an abbreviation of a general actuator with the force
``gain command + bias0 + bias1 length + bias2 velocity``. Tested in ``tests/test_mjcf.py`` against MuJoCo.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ...errors import RobotError
from ..transmission import Actuator
from .mjcf_sections import by_class, inside
from .xml_spans import Element

SHORTCUTS = (
    "general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle",
    "adhesion", "dcmotor", "pid",
)  # fmt: skip
"""Elements of ``<actuator>`` and of its defaults."""

KEPT = ("forcerange", "ctrlrange", "forcelimited", "ctrllimited", "gear")
"""Attributes common to all kinds of actuators."""

SAME = 1e-9
"""Largest difference of gain and bias, as a share of the gain, at which an actuator has one gain on the position error."""


@dataclass(frozen=True)
class Setting:
    """An actuator in MuJoCo's form, on the motor's side of the gear.

    Attributes
    ----------
    tag : str
        Element that set it last.
    gaintype, biastype, dyntype : str
        Types of gain, bias and activation.
    gain, lag_s : float
        First parameters of the gain and of the activation.
    bias : tuple of float
        First three parameters of the bias.
    ratio : bool
        Whether the file has a damping ratio, from which MuJoCo computes the velocity gain.
    other : mapping of str to str
        Attributes of `KEPT`.
    """

    tag: str = "general"
    gaintype: str = "fixed"
    biastype: str = "none"
    dyntype: str = "none"
    gain: float = 1.0
    lag_s: float = 1.0
    bias: tuple[float, ...] = (0.0, 0.0, 0.0)
    ratio: bool = False
    other: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_position(self) -> bool:
        """Whether the force is a gain times the position error plus damping."""
        fits = self.gaintype == "fixed" and self.biastype == "affine" and self.bias[0] == 0.0
        return fits and self.gain > 0.0 and abs(self.gain + self.bias[1]) <= SAME * self.gain

    def with_element(self, element: Element, where: str) -> Setting:
        """Return the setting with the attributes of an element.

        Raises
        ------
        RobotError
            For a text in place of numbers.
        """
        tag, given = element.tag, element.attributes

        def first(key: str, default: float) -> float:
            return _numbers(element, key, (default,), where)[0]

        setting = replace(
            self, tag=tag, other={**self.other, **{key: given[key] for key in KEPT if key in given}}
        )
        if tag == "motor":
            return replace(setting, gaintype="fixed", biastype="none", dyntype="none", gain=1.0)
        if tag == "velocity":
            kv = first("kv", self.gain)
            return replace(setting, gaintype="fixed", biastype="affine", gain=kv, bias=(0.0, 0.0, -kv))
        if tag == "position":
            kp, kv = first("kp", self.gain), first("kv", -self.bias[2])
            setting = replace(setting, gaintype="fixed", biastype="affine", gain=kp, bias=(0.0, -kp, -kv))
            if "timeconst" in given:
                setting = replace(setting, dyntype="filterexact", lag_s=first("timeconst", 0.0))
            return replace(setting, ratio=bool(first("dampratio", 0.0)) or (self.ratio and "kv" not in given))
        if tag != "general":
            return replace(setting, gaintype=tag)
        return replace(
            setting,
            gaintype=given.get("gaintype", self.gaintype),
            biastype=given.get("biastype", self.biastype),
            dyntype=given.get("dyntype", self.dyntype),
            gain=first("gainprm", self.gain),
            lag_s=first("dynprm", self.lag_s),
            bias=_numbers(element, "biasprm", self.bias, where),
        )

    @property
    def gear(self) -> float:
        """Size of the gear ratio."""
        return abs(float(self.other.get("gear", "1").split()[0]))

    def limit(self, key: str, autolimits: bool) -> float | None:
        """Return the larger end of ``forcerange`` or ``ctrlrange``; None where it does not limit."""
        switch = self.other.get(key.replace("range", "limited"), "auto")
        if switch == "false" or (switch == "auto" and not autolimits) or key not in self.other:
            return None
        return max(abs(float(word)) for word in self.other[key].split()) or None


def _numbers(element: Element, key: str, default: tuple[float, ...], where: str) -> tuple[float, ...]:
    """First numbers of an attribute; those of the default where it has fewer."""
    text = element.attributes.get(key)
    if text is None:
        return default
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        values = ()
    if not values or not all(map(math.isfinite, values)):
        raise RobotError(
            f"{where}: line {element.line}: {key} of <{element.tag}> must be numbers, got {text!r}"
        )
    return (*values, *default[len(values) :])[: len(default)]


def actuator_settings(sections: list[Element], where: str) -> dict[str, tuple[Element, Setting]]:
    """Return the last actuator of each joint that has one, by name of the joint.

    Raises
    ------
    RobotError
        For an unknown class, or a text in place of numbers.
    """
    defaults = by_class(
        sections,
        Setting(),
        lambda own, child: own.with_element(child, where) if child.tag in SHORTCUTS else own,
    )
    settings: dict[str, tuple[Element, Setting]] = {}
    for element in inside(sections, "actuator"):
        joint = element.attributes.get("joint")
        name = element.attributes.get("class", "main")
        if element.tag not in SHORTCUTS or joint is None:
            continue
        if name not in defaults:
            raise RobotError(f"{where}: line {element.line}: there is no default class {name!r}")
        settings[joint] = element, defaults[name].with_element(element, where)
    return settings


def read_actuators(
    sections: list[Element], own_limits: Mapping[str, float], autolimits: bool, where: str
) -> tuple[dict[str, Actuator], list[str]]:
    """Return the actuator of each joint that has one, and sentences on unsupported ones.

    Parameters
    ----------
    sections : list of Element
        Sections of the file, with those of included files.
    own_limits : mapping of str to float
        Largest torque that a joint takes from actuators, ``actuatorfrcrange``, by name of the joint.
    autolimits : bool
        Whether a range limits by itself.
    where : str
        Name of the file, which opens messages.

    Raises
    ------
    RobotError
        For an unknown class, or a text in place of numbers.
    """
    actuators: dict[str, Actuator] = {name: Actuator(effort=limit) for name, limit in own_limits.items()}
    unread: list[str] = []
    for joint, (element, setting) in actuator_settings(sections, where).items():
        try:
            actuators[joint] = _on_joint(setting, own_limits.get(joint), autolimits)
        except ValueError:
            raise RobotError(
                f"{where}: line {element.line}: ranges and gear of the actuator of {joint!r} must be numbers"
            ) from None
        if setting.ratio:
            unread.append(
                f"kv of the actuator of {joint}, which MuJoCo computes of dampratio (mj_saveLastXML writes it)"
            )
        elif actuators[joint].kp is None and setting.tag not in ("motor", "general", "velocity"):
            unread.append(f"the actuator <{setting.tag}> of {joint}")
    return actuators, unread


def _on_joint(setting: Setting, own_limit: float | None, autolimits: bool) -> Actuator:
    """Return an actuator in joint-side quantities: gains times the squared gear ratio, torques times the gear ratio."""
    gear = setting.gear
    force = setting.limit("forcerange", autolimits)
    if force is None and setting.gaintype == "fixed" and setting.biastype == "none":
        command = setting.limit("ctrlrange", autolimits)
        force = None if command is None else command * abs(setting.gain)
    limits = [limit for limit in (None if force is None else gear * force, own_limit) if limit]
    effort = min(limits, default=None)
    if not setting.is_position:
        return Actuator(effort=effort)
    return Actuator(
        kp=gear**2 * setting.gain,
        kv=None if setting.ratio else gear**2 * -setting.bias[2],
        effort=effort,
        lag_s=setting.lag_s if setting.dyntype in ("filter", "filterexact") else 0.0,
    )
