"""Outputs that cannot be written, for `fuzz.py`: no result may be lost, and no traceback may be printed.

Every command that writes a file is run in a process of its own with an absent folder, a folder, a full device, links in a circle
and a limit of the size of files in the way of its output, and with a stdout that is full. It must refuse before the work, or print
its result, or say where the result is instead. An output that is a file which the command reads must be refused before the work,
by its path and by a link of either kind. Then threads save to one path, all at once.
"""

from __future__ import annotations

import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import didim

LIMIT_S = 120.0
"""After this a case counts as failed."""
MEMORY_GB = 3
FULL = Path("/dev/full")
SIZES = (0, 300, 3000)
"""Limits of the size of a file, in bytes."""
THREADS, SAVES = 8, 100
READ = (".toml", ".json", ".csv")
"""Endings of the files that the commands read."""
WAYS = ("path", "symbolic link", "hard link")
"""Kinds of outputs that lead to an input file."""

CLOE = ("identify", "sliding.toml", "--method", "cloe", "--quiet")
COMMANDS: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("identify", "log.toml", "--quiet"), "--json", ".json"),
    (("identify", "log.toml", "--quiet"), "--save-parameters", ".toml"),
    (("identify", "log.toml", "--quiet"), "--save-parameters", ".npz"),
    (("identify", "sliding.toml", "--method", "didim", "--quiet"), "--json", ".json"),
    (CLOE, "--json", ".json"),
    (CLOE[:-1], "--checkpoint", ".npz"),
    (("validate", "fit.json", "log.toml"), "--json", ".json"),
    (("simulate", "fourier.toml", "--parameters", "reference"), "-o", ".csv"),
    (("check", "log.toml"), "--json", ".json"),
    (("init", "arm.toml", "log.csv"), "-o", ".toml"),
)
"""Commands, the option of an output, and the ending of its file."""
PRINTED: tuple[tuple[str, ...], ...] = (
    ("identify", "log.toml"),
    ("validate", "fit.json", "log.toml"),
)
"""Commands whose result is on stdout."""


@dataclass(frozen=True)
class Case:
    """A command line with something in the way of its output."""

    name: str
    arguments: tuple[str, ...]
    early: bool = False
    """Whether it can be refused before the work."""
    size: int | None = None
    """Limit of the size of files, in bytes."""
    stdout: Path | None = None
    source: str | None = None
    """File that is read, and that the output is."""
    way: str = ""
    """One of `WAYS`."""


@dataclass(frozen=True)
class Ending:
    """How a case ended."""

    code: int
    out: str
    err: str


def cases() -> Iterator[Case]:
    """Every output with everything that can be in its way."""
    for command, option, ending in COMMANDS:
        what = f"{command[0]} {option} {ending}"
        yield Case(f"{what}, absent folder", (*command, option, f"absent/out{ending}"), early=True)
        yield Case(f"{what}, a folder", (*command, option, f"folder{ending}"), early=True)
        yield Case(f"{what}, a circle", (*command, option, f"circle{ending}"), early=True)
        for source in (word for word in command if Path(word).suffix in READ):
            for way in WAYS:
                target = source if way == "path" else f"alias{ending}"
                yield Case(
                    f"{what}, {way} of {source}",
                    (*command, option, target),
                    early=True,
                    source=source,
                    way=way,
                )
        if FULL.exists():
            yield Case(f"{what}, full device", (*command, option, str(FULL)), early=True)
        for size in SIZES:
            # What `init` does is done again in no time.
            early = command[0] == "init"
            yield Case(f"{what}, {size} bytes", (*command, option, f"out{ending}"), early=early, size=size)
    for command in PRINTED:
        if FULL.exists():
            yield Case(f"{command[0]}, stdout full", command, stdout=FULL)


def run(case: Case, folder: Path) -> Ending:
    """Run a case in a folder with the sound files."""
    if case.source is not None and case.way == "hard link":
        (folder / case.arguments[-1]).hardlink_to(folder / case.source)
    elif case.source is not None and case.way == "symbolic link":
        (folder / case.arguments[-1]).symlink_to(case.source)

    def limit() -> None:
        # The signal would end the process before the error is seen.
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        if case.size is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (case.size, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_GB << 30,) * 2)

    command = [sys.executable, "-B", "-m", "didim", *case.arguments]
    stdout = subprocess.PIPE if case.stdout is None else case.stdout.open("w")
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
            timeout=LIMIT_S,
            check=False,
            preexec_fn=limit,
        )
    except subprocess.TimeoutExpired:
        return Ending(-1, "", f"not finished within {LIMIT_S} s")
    finally:
        if stdout != subprocess.PIPE:
            stdout.close()  # type: ignore[union-attr]
    return Ending(done.returncode, done.stdout or "", done.stderr)


def complaint(case: Case, ending: Ending, folder: Path, sound: Path | None = None) -> str:
    """Return what is wrong with an ending: an empty text when nothing is; `sound` has the files as they were."""
    if ending.code not in (0, 1, 2) or any(word in ending.err for word in ("Traceback", "panicked")):
        return f"exit code {ending.code}\n{ending.err}"
    if case.source is not None and sound is not None:
        if (folder / case.source).read_bytes() != (sound / case.source).read_bytes():
            return f"lost: {case.source} was written over\n{ending.err}"
        if ending.code != 2:
            return f"not refused: an output that is {case.source}\n{ending.err}"
    if ending.code == 2:
        if not case.early:
            return f"lost: refused after the work\n{ending.err}"
        lines = [line for line in ending.err.splitlines() if line.startswith("didim: ")]
        return "" if len(lines) == 1 and not ending.out else f"refused without one sentence\n{ending.err}"
    written = folder / case.arguments[-1]
    if not case.early and written.is_file() and written.stat().st_size:
        return ""  # smaller than the limit
    places = [folder / place for place in re.findall(r"is in '([^']+)' instead", ending.err)]
    if any(not place.is_file() or not place.stat().st_size for place in places):
        return f"lost: nothing is where the sentence says\n{ending.err}"
    if not places and not ending.out.strip():
        return f"lost: neither printed nor written\n{ending.err}"
    return ""


def threads(folder: Path) -> list[str]:
    """Save one result to one path from many threads at once; return the complaints."""
    fit = didim.Identification.load(folder / "fit.json")
    target = folder / "same.json"

    def save(number: int) -> str:
        try:
            fit.save(target)
        except OSError as reason:
            return f"save {number}: {reason}"
        return ""

    with ThreadPoolExecutor(THREADS) as pool:
        wrong = [text for text in pool.map(save, range(THREADS * SAVES)) if text]
    if didim.Identification.load(target).to_dict() != fit.to_dict():
        wrong.append("the file that stayed is another one")
    left = [path.name for path in folder.iterdir() if path.name.endswith(".tmp")]
    return wrong + [f"{name} was left" for name in left]


def outputs(material: Path, folder: Path, chosen: Sequence[Case] | None = None) -> int:
    """Run all cases and the threads, print what became of them, and return the number of complaints.

    Parameters
    ----------
    material : Path
        The sound files of `fuzz_material.make`.
    folder : Path
        Where each case runs; emptied before it.
    chosen : sequence of Case, optional
        Cases instead of all.
    """
    found = []
    every = list(cases()) if chosen is None else list(chosen)
    for case in every:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(material, folder)
        for ending in {ending for _, _, ending in COMMANDS}:
            (folder / f"folder{ending}").mkdir()
            (folder / f"circle{ending}").symlink_to(f"circle{ending}")
        text = complaint(case, run(case, folder), folder, material)
        if text:
            found.append(f"{case.name}: {text}")
    lost = sum(": lost" in text for text in found)
    print(
        f"{len(every)} outputs that cannot be written: {len(every) - len(found)} well, {lost} lost, {len(found) - lost} failed"
    )
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(material, folder)
    wrong = threads(folder)
    print(f"{THREADS} threads, {THREADS * SAVES} saves to one path: {len(wrong)} failed")
    for text in (*found, *wrong):
        print(f"failed: {text}")
    return len(found) + len(wrong)
