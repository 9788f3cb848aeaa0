"""Identified robots go back into their own files: do other engines find the torques of the fit there, and is the rest untouched?

    python benches/round_trips.py PATH [PATH ...]

identifies each robot of these URDFs and MJCFs, or of folders of them, on a simulated log of other links and drives than its file
has, writes the physically consistent parameters into a copy of the file, and replays random states of it: an MJCF in MuJoCo
without what the notes say is left out, a URDF in Pinocchio. Prints for each file its joints, the largest difference to the torques
of the fit over the largest torque, and what differs beside the attributes of inertias and drives. Wheels with such files:
example-robot-data, robosuite, dm-control, playground, gymnasium-robotics, metaworld. Ends with 1 if a difference is above 1e-10, or
a text differs elsewhere.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
import warnings
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

import didim
from didim.errors import DidimError
from didim.export.consistent import consistent_parameters, links_between
from didim.export.source import Source
from didim.export.write import into_mjcf
from didim.robot.transmission import driven_part, joint_motion
from didim.robot.urdf.mjcf_elements import mjcf_elements

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from mjcf_corpus import File, switch_off

from robots import changed, random_motion
from simulated import experiment, log
from urdfs import pinocchio_model, pinocchio_torques

TOLERANCE = 1e-10
"""Largest difference of torques, as a share of the largest one."""
SAMPLES = 1500
"""Samples of a log."""
NOISE = 0.01
"""Noise of a log's torques, rms (N.m or N)."""
LINK = ("pos", "mass", "diaginertia", "fullinertia", "quat", "euler", "axisangle", "xyaxes", "zaxis")
"""Attributes of ``<inertial>``."""
DRIVE = ("armature", "damping", "frictionloss", "stiffness", "springref")
"""Attributes of a joint, or a tendon, that an export writes."""
WRITTEN = {
    "joint": DRIVE,
    "fixed": DRIVE[:3],
    "compiler": ("inertiafromgeom", "settotalmass", "boundmass", "boundinertia"),
}
"""Attributes of elements of an MJCF that an export writes."""
OTHERS = (
    r"<inertial\b[^>]*/>|<inertial\b.*?</inertial>|<!-- (inertial|didim): .*?-->|<dynamics\b[^>]*/>|"
    r"</?mujoco(include)?\b[^>]*>"
)
"""Inertias and drives of a URDF, inertias of an MJCF, and what opens and closes its parts."""
INCLUDE = r"""<!--.*?-->|<include\s+file=["']([^"']*)["']\s*(?:/>|>\s*</include>)"""
"""Includes, and comments, which may have some."""
PREFIX = r"\b(drake|drive|controller|sensor|interface):"
"""Prefixes that nobody declares, at which Pinocchio's parser stops."""


class Trip(NamedTuple):
    """A robot that went into its own file: joints, difference of torques, the first other difference of the text, new inertias."""

    joints: int
    difference: float
    elsewhere: str
    told: str = ""


def round_trip(path: Path, folder: Path) -> Trip:
    """Identify the robot of a file, write it into a copy in a folder, and replay the copy."""
    robot = didim.load_robot(path, snap=0.0, open=True)
    kind = "urdf" if path.suffix == ".urdf" else "mjcf"
    recorded = experiment(robot, log(robot, changed(robot, kind), n_samples=SAMPLES, noise=NOISE))
    fit = didim.identify(recorded, didim.IDIMLS())
    x = consistent_parameters(fit, robot, empty=links_between(robot)).x.copy()
    motion = random_motion(np.random.default_rng(3), 20, robot.n_dof)
    state = motion.q, motion.dq, motion.ddq
    before, told = _whole(path.read_text(), path.parent), ""
    # MuJoCo takes Coulomb friction for a constraint, and an offset beside a spring for its rest; Pinocchio has no drives.
    kept = r"(XX|XY|XZ|YY|YZ|ZZ|MX|MY|MZ|M)\d"
    if kind == "urdf":
        content = didim.export.to_urdf(robot, x, path)
        after = content.decode()
        found = by_pinocchio(after, robot, *state)
    else:
        content, told, _ = into_mjcf(path, Source(robot, x), None)
        copy = folder / f"{path.stem}_written{path.suffix}"
        after = _whole(content.decode(), path.parent)
        meshes = path.parent / ([*re.findall(r'\b(?:meshdir|assetdir)="([^"]*)"', after), ""][0])
        copy.write_text(after.replace("</mujoco>", f'<compiler meshdir="{meshes}"/></mujoco>'))
        file = File(robot, mjcf_elements(copy).reader.model)
        switch_off(file, " ".join(robot.notes))
        found = file.replay(*state)[0]
        rests = [f"Off{name[2:]}$" for name in robot.parameter_names if name.startswith("Ks")]
        kept = "|".join([kept, "Ia", "Fv", "Ks", *rests])
    for index, name in enumerate(robot.parameter_names):
        x[index] *= re.match(kept, name) is not None
    tau = didim.inverse_dynamics(robot, *state, x)
    difference = float(np.abs(found - tau).max() / np.abs(tau).max())
    return Trip(robot.n_dof, difference, elsewhere(before, after), told)


def by_pinocchio(text: str, robot: didim.Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """Return torques of the driven joints by Pinocchio."""
    places, followers = robot.correspondence, robot.geometry.followers
    assert places is not None
    model = pinocchio_model(re.sub(PREFIX, r"\1_", text), robot.all_joint_names, dict(places.lock))
    model.gravity.linear = places.base_matrix[:3, :3] @ robot.geometry.gravity
    motion = (joint_motion(followers, each, position=each is q) for each in (q, dq, ddq))
    return driven_part(followers, pinocchio_torques(model, robot.all_joint_names, *motion))


def _whole(text: str, *folders: Path) -> str:
    """Return a text with the files that it includes, beside the main one or their own, in their places."""

    def part(include: re.Match[str]) -> str:
        if not include[1]:
            return include[0]  # a comment
        path = next(path for folder in folders if (path := folder / include[1]).is_file())
        inside = _whole(path.read_text(), folders[0], path.parent)
        return re.sub(r"</?mujoco(include)?\b[^>]*>|<\?.*?\?>", "", inside)

    return re.sub(INCLUDE, part, text, flags=re.DOTALL)


def elsewhere(before: str, after: str) -> str:
    """Return the first difference of two texts of a robot beside inertias and drives; an empty text without one."""
    tokens = []
    for text in (before, after):
        left = re.sub(OTHERS, "", text, flags=re.DOTALL)
        for tag, names in WRITTEN.items():
            attribute = rf"""\s+({"|".join(names)})\s*=\s*("[^"]*"|'[^']*')"""
            for found in re.findall(rf"<{tag}\b[^>]*>", left):
                left = left.replace(found, re.sub(attribute, "", found))
        words = re.findall(r"<[^>]*>|[^<\s]+", left)
        tokens.append([" ".join(word.replace("/>", " />").split()) for word in words])
    for one, other in zip_longest(*tokens, fillvalue="nothing"):
        if one != other:
            return f"{one} / {other}"
    return ""


def main() -> int:
    """Send all robots through their files and print a line each; return 1 if one comes back otherwise."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paths", nargs="+", type=Path, metavar="PATH")
    files = [
        file.resolve()
        for path in parser.parse_args().paths
        for file in ([path] if path.is_file() else sorted(path.rglob("*")))
        if file.suffix == ".urdf"
        or (file.suffix == ".xml" and b"<mujoco" in file.read_bytes().replace(b"<mujocoinclude", b""))
    ]
    mujoco.set_mju_user_warning(lambda _: None)
    warnings.simplefilter("ignore")
    good, bad = 0, 0
    for file in files:
        began = time.perf_counter()
        try:
            with tempfile.TemporaryDirectory() as folder:
                trip = round_trip(file, Path(folder))
        except DidimError as reason:
            print(f"{'refused':>19}  {reason}"[:240], flush=True)
            continue
        same = trip.difference <= TOLERANCE and not trip.elsewhere
        good, bad = good + same, bad + (not same)
        text = f"  {trip.elsewhere}" if trip.elsewhere else ""
        name = "/".join(file.parts[-2:])
        print(
            f"{trip.joints:3} joints  {trip.difference:.1e}  {name}  {time.perf_counter() - began:.1f} s{text}"[
                :240
            ],
            flush=True,
        )
    print(f"{good} of {len(files)} robots went into their files and came back, {bad} came back otherwise")
    return int(bad > 0)


if __name__ == "__main__":
    raise SystemExit(main())
