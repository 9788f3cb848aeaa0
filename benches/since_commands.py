"""Rows of `since_0_2_0.py` that commands show, each in an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from since_observe import EXPERIMENT, TREE, motion, run, table
from since_observe import log as write_log

import didim

STUDY = """\
schema = 1
name = "small"
experiment = "PLACE/planar2_simulation.toml"
parameters = "reference"
refinement = 1
method = ["idim-ls"]
[grid]
"measurement.torque_noise_n_m" = [[0.1, 0.05], [0.5, 0.2]]
"simulation.duration_s" = [2.0]
"simulation.rate_hz" = [200]
"simulation.step_s" = [0.002]
"simulation.fine_step_s" = [0.002]
[repeat]
seeds = 3
root = 7
"""
BOMB = """
import zipfile, io, numpy as np
head = io.BytesIO(); np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (200000000, 2)})
with zipfile.ZipFile("bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
    for name in ("q", "tau"):
        with archive.open(name + ".npy", "w", force_zip64=True) as file:
            file.write(head.getvalue()); zeros = bytes(1 << 24)
            for _ in range(95): file.write(zeros)
"""


def outputs_on_inputs() -> str:
    """Each output is a file that the command reads."""
    destroyed = 0
    tries = (
        ("--report", "log.csv"),
        ("--json", "link.json"),
        ("--json", "log.toml"),
        ("--save-parameters", "log.toml"),
    )
    for option, name in tries:
        write_log()
        Path("link.json").unlink(missing_ok=True)
        Path("link.json").symlink_to("log.csv")
        before = [Path(file).read_bytes() for file in ("log.csv", "log.toml")]
        run("identify", "log.toml", option, name)
        destroyed += before != [Path(file).read_bytes() for file in ("log.csv", "log.toml")]
    study = STUDY.replace("PLACE", str(TREE / "examples"))
    for name in ("study.toml", "notes.txt"):
        Path("study.toml").write_text(study, encoding="utf-8")
        Path("notes.txt").write_text("notes of mine", encoding="utf-8")
        files = [Path("study.toml").read_text(), Path("notes.txt").read_text()]
        run("study", "study.toml", "--quiet", "--executor", "serial", "-o", name)
        destroyed += files != [Path("study.toml").read_text(), Path("notes.txt").read_text()]
    return f"{destroyed} of {len(tries) + 2} destroyed"


def rows_of_a_study() -> str:
    """A truth is cut, and the estimate of a row is edited."""
    Path("study.toml").write_text(STUDY.replace("PLACE", str(TREE / "examples")), encoding="utf-8")
    run("study", "study.toml", "--quiet", "--executor", "serial", "-o", "rows.jsonl")
    lines = Path("rows.jsonl").read_text(encoding="utf-8").splitlines()
    edited = [number for number, line in enumerate(lines) if '"beta"' in line][-1]
    changed = list(lines)
    changed[edited] = re.sub(r'"beta": ?\[[-0-9.e]+', '"beta":[1e6', changed[edited])
    Path("edited.jsonl").write_text("\n".join(changed) + "\n", encoding="utf-8")
    outcome = run("study", "edited.jsonl")
    believed = "as written" not in outcome.out + outcome.err
    cut = next(number for number, line in enumerate(lines) if '"truth"' in line)
    Path("cut.jsonl").write_text(
        "\n".join([*lines[:cut], lines[cut][:-40], *lines[cut + 1 :]]) + "\n", encoding="utf-8"
    )
    outcome = run("study", "cut.jsonl")
    named = "damaged" in outcome.out + outcome.err
    return f"edited row {'believed' if believed else 'dropped and named'}, damaged one {'named' if named else 'called unfinished'}"


def odd_names() -> str:
    """A name that is not UTF-8, and a link to itself."""
    write_log()
    Path("loop.json").symlink_to("loop.json")
    found = [
        run("identify", "log.toml", "--json", name) for name in (os.fsdecode(b"fit\xff.json"), "loop.json")
    ]
    lost = sum(item.traceback for item in found)
    return f"{lost} of 2 end in a traceback"


def unsnapped_angles() -> str:
    """A URDF with 1.57079 for pi/2, read with `--snap 0`, and the robot file that is written of it."""
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="0.1 0 0.2" rpy="{1.57079 * (k > 0)} 0 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="2" effort="50"/></joint>'
        for k in range(4)
    )
    body = '<inertial><mass value="2"/><inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="l{k}">{body if k else ""}</link>' for k in range(5))
    Path("arm.urdf").write_text(f'<robot name="arm">{links}{joints}</robot>', encoding="utf-8")
    run("robot", "arm.urdf", "--snap", "0", "-o", "arm.toml")
    counts = [len(didim.load_robot(*item).base_parameters.names) for item in (("arm.toml",),)]
    whole = len(didim.load_robot("arm.urdf", snap=0.0).base_parameters.names)
    return f"{whole} base parameters, {counts[0]} by the robot file"


def jittered(seed: int = 0) -> None:
    """1 kHz in 21 s with jitter of a tenth of the step: jitter.csv."""
    t, q, tau = motion(1000.0, 21.0)
    rng = np.random.default_rng(seed)
    uneven = np.r_[0.0, np.cumsum(1.05e-3 * (1.0 + 0.1 * rng.uniform(-1.0, 1.0, 19_999)))]
    uneven = uneven[uneven < t[-1]]
    columns = [np.column_stack([np.interp(uneven, t, one) for one in values.T]) for values in (q, tau)]
    columns[1] = columns[1] + 0.3 * rng.standard_normal(columns[1].shape)
    stamps = uneven + 1.05e-4 * rng.uniform(-1.0, 1.0, len(uneven))
    columns[0] = columns[0] + 1e-3 * rng.standard_normal(columns[0].shape)
    table("jitter.csv", ("t", "q1", "q2", "tau1", "tau2"), stamps, *columns)


def check_of_gaps() -> str:
    """1 kHz with 24 lost samples, decimation by 10 and 8."""
    t, q, tau = motion(1000.0, 20.0)
    lost = np.unique([begin + 2400 * k for begin in (600, 640, 901) for k in range(8)])
    kept = np.setdiff1d(np.arange(len(t)), lost)
    tau = tau + 0.1 * np.random.default_rng(0).standard_normal(tau.shape)
    table("log.csv", ("t", "q1", "q2", "tau1", "tau2"), t[kept], q[kept], tau[kept])
    text = EXPERIMENT.replace("500", "1000").replace("[5]", "[10, 8]")
    stamps = 'time = { file = "log.csv", columns = ["t"], unit = "s" }\nposition'
    Path("log.toml").write_text(text.replace("position", stamps, 1), encoding="utf-8")
    ended = run("check", "log.toml")
    outcome = ended.out + ended.err
    return (
        "the filters are refused"
        if "cannot be filtered" in outcome or "needs more than" in outcome
        else "checked"
    )


def band_of_jitter() -> str:
    """What `init` chooses for it; the motion ends at 0.4 Hz."""
    jittered()
    outcome = run("init", "planar2", "jitter.csv").out
    band = re.search(r"below ([0-9.]+) Hz", outcome)
    decimated = re.search(r"decimation by (\d+)", outcome)
    return f"band of {band[1] if band else 'no'} Hz, {'' if decimated else 'not '}decimated"


def example() -> str:
    """The commands that `didim example tx40` prints, up to the result."""
    printed = run("example", "tx40").out.partition("\ncd tx40\n")[2].splitlines()
    os.chdir("tx40")
    for command in printed:
        program, *words = command.split()
        if program == "didim":
            found = run(*words)
        else:
            subprocess.run(["sh", "-c", command], check=True)
        if words and words[0] == "identify":
            (line,) = re.findall(r"^fit .*$", found.out, re.MULTILINE)
            return f"{line.split()[-1]} % torque error"
    return "no result"


def first_order_ends() -> str:
    """A recipe of 0.1.0 for the digits of others says that the ends are of another order now."""
    write_log()
    Path("log.toml").write_text(EXPERIMENT + 'padding = "matlab"\n', encoding="utf-8")
    outcome = run("identify", "log.toml", "--quiet")
    return "said" if "ends" in outcome.out + outcome.err else "not said"


def bounds_of_inputs() -> str:
    """A FIFO, /dev/zero, an archive of 3 GB in 3 MB, a header of a million columns, a key of 50 000 dots."""
    write_log()
    found = []
    os.mkfifo("pipe.csv")
    text = EXPERIMENT
    subprocess.run([sys.executable, "-c", BOMB], check=True)
    files = {"pipe.csv": "pipe.csv", "zero": "/dev/zero", "bomb.npz": "bomb.npz", "wide.csv": "wide.csv"}
    Path("wide.csv").write_text(",".join(f"c{k}" for k in range(1_000_000)) + "\n1\n", encoding="utf-8")
    for name, file in files.items():
        changed = text.replace("log.csv", file)
        if name == "bomb.npz":
            changed = changed.replace('columns = ["q1", "q2"]', 'variable = "q"').replace(
                'columns = ["tau1", "tau2"]', 'variable = "tau"'
            )
        Path("bad.toml").write_text(changed, encoding="utf-8")
        found.append(run("identify", "bad.toml", patience_s=60.0).word)
    Path("bad.toml").write_text(text + ".".join("a" for _ in range(50_000)) + " = 1\n", encoding="utf-8")
    found.append(run("identify", "bad.toml", patience_s=60.0).word)
    return f"{found.count('refused')} of {len(found)} refused"


def signals_in_files() -> str:
    """Positions and torques in a file each; a German file; numbers of columns beside names."""
    t, q, tau = motion()
    tau = tau + 0.1 * np.random.default_rng(0).standard_normal(tau.shape)
    table("run_position.csv", ("Joint_1", "Joint_2"), q)
    table("run_torque.csv", ("Joint_1", "Joint_2"), tau)
    table("log.csv", ("t", "q1", "q2", "tau1", "tau2"), t, q, tau)
    Path("german.csv").write_text(
        Path("log.csv").read_text(encoding="utf-8").replace(",", ";").replace(".", ","), encoding="utf-8"
    )
    tries = (
        ("run_position.csv", "run_torque.csv", "--rate", "500", "-o", "a.toml"),
        ("german.csv", "-o", "b.toml"),
        ("log.csv", "--columns", "position=2-3", "--columns", "torque=4-5", "-o", "c.toml"),
    )
    good = 0
    for words in tries:
        run("init", "planar2", *words)
        good += Path(words[-1]).is_file() and run("identify", words[-1], "--quiet").code in (0, 1)
    return f"{good} of {len(tries)} get in"


def open_gains() -> str:
    """Currents whose gain is to be estimated."""
    t, q, tau = motion()
    table("log.csv", ("t", "q1", "q2", "i1", "i2"), t, q, tau)
    return run("init", "planar2", "log.csv", "--gain", "estimate").word


def mistakes() -> str:
    """Eight mistakes of a first hour: how many are answered by what to do."""
    write_log()
    run("identify", "log.toml", "--json", "fit.json")
    bad = EXPERIMENT.replace('"q2"]', '"q22"]')
    Path("bad.toml").write_text(bad, encoding="utf-8")
    Path("six.toml").write_text(EXPERIMENT.replace("planar2", "ur5e"), encoding="utf-8")
    tries = (
        (("identify", "log.csv"), "didim init"),
        (("identify", "fit.json"), "result"),
        (("init", "log.csv", "planar2"), "init planar2 log.csv"),
        (("identify", "log.toml", "--metod", "didim"), "--method"),
        (("identfy", "log.toml"), "did you mean 'identify'"),
        (("identify", "log.toml", "--method", "idimls"), "did you mean 'idim-ls'"),
        (("identify", "log.toml", "--method", "didim"), "[controller]"),
        (("identify", "bad.toml"), "did you mean 'q2'"),
    )
    answered = 0
    for words, wanted in tries:
        outcome = run(*words)
        answered += wanted in outcome.out + outcome.err and outcome.code == 2 and not outcome.traceback
    return f"{answered} of {len(tries)} answered"
