"""Wrong files through the command line: each case must end in a result or in one sentence.

    python benches/fuzz.py [--count 10000] [--seed 0] [--jobs 1] [--first CASE] [--cases-only] [--resume]
    python benches/fuzz.py --count 0                         outputs that cannot be written, alone

A case mutates the files of a command (`fuzz_material.py`, `fuzz_mutate.py`) one to three times, in one case of eight puts a
hostile file in the place of one of them, and in one of eight makes an output of a file that the command reads
(`fuzz_hostile.py`). It runs in process. It must
end with exit code 0 or 1 and nothing but sentences on stderr, or with exit code 2, nothing on stdout and one sentence on stderr
behind notes on what was assumed:
no traceback, no panic, no warning of NumPy or SciPy, no file lost that it does not own, no more than `MEMORY_GB` of memory. A case
that takes more than `LIMIT_S` of processor time is interrupted as by Ctrl-C; that it must hear, and it counts as long. Cases
depend on the seed and on nothing else. A case that
fails is kept with its files and its command under ``out/fuzz/``, and one that was long; every `REPORT_EVERY` cases a
line counts them.
What became of each case stands in ``out/fuzz/seed-N.txt``: ``--resume`` leaves out those that are there.
Then `fuzz_outputs.py` takes the outputs
away: absent folders, full devices, limits of the size of files, and eight threads that save to one path.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import io
import json
import os
import random
import selectors
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
import warnings
from pathlib import Path
from types import FrameType

LIMIT_S = 10.0
"""Processor time (s) after which a case is interrupted; a sound one takes some milliseconds."""
DEAF_S = 300.0
"""Time (s) by the clock after which a case has not heard, and its process is ended; other programs may share the processor."""
MEMORY_GB = 1.0
"""Largest memory of the process of a case, modules included."""
FRESH_GB = 0.5
"""Memory of a case after which the next one gets a new process: what the allocator keeps would count for it."""
ADDRESSES_GB = 6
"""Limit of the address space: memory that is asked for and not used counts here."""
LONGEST_SENTENCE = 1200
LARGEST_KEPT = 100_000_000
"""Largest file (bytes) of a case that is kept."""
STRANGE = 0.125
"""Share of cases with a hostile file, and share of those whose output is an input."""
REPORT_EVERY = 500
"""Cases between two lines on standard output that count them."""
OUTPUT = Path("out", "fuzz")


def run_case(folder: Path, material: Path, seed: int, number: int) -> tuple[str, str, list[str]]:
    """Mutate and run one case.

    Parameters
    ----------
    folder : Path
        Where its files go; emptied first.
    material : Path
        The sound files.
    seed, number : int
        Which case.

    Returns
    -------
    outcome, complaint : str
        ``result``, ``refused``, ``long`` or ``failed``; what is wrong, for a failed one.
    command : list of str
        Arguments and mutations.
    """
    from fuzz_hostile import alias, hostile, losses, snapshot
    from fuzz_material import SCENARIOS
    from fuzz_mutate import mutate

    rng = random.Random(f"{seed} {number}")
    (scenario,) = rng.choices(SCENARIOS, [item.weight for item in SCENARIOS])
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(material, folder)
    os.chdir(folder)
    way = rng.random()
    changes = rng.choice((1, 1, 1, 2, 3)) if way > 2.0 * STRANGE else 0
    done = [mutate(Path(rng.choice(scenario.files)), rng) for _ in range(changes)]
    arguments = list(scenario.arguments)
    if way < STRANGE:
        done.append(hostile(Path(rng.choice(scenario.files)), rng))
    elif way < 2.0 * STRANGE:
        done.append(alias(arguments, scenario.files, rng))
    if rng.random() < 0.02:
        arguments[rng.randrange(1, len(arguments))] = rng.choice(("", "x", "nan", "-1", "log.csv", "."))
        done.append("argument")
    Path("command.txt").write_text(f"didim {shlex.join(arguments)}\n# {'; '.join(done)}\n", encoding="utf-8")
    before = snapshot()
    forget_peak()
    outcome, complaint = judge(arguments)
    complaint += losses(before, arguments, scenario.files)
    used = peak_gb()
    if used > MEMORY_GB:
        complaint += f"\n{used:.2f} GB of memory"
    return outcome, complaint, done


def forget_peak() -> None:
    """Let the system measure the largest memory of this process anew."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_gb() -> float:
    """Largest resident memory (GB) of this process since `forget_peak`; 0 where the system does not say."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e9
    return 0.0


def judge(arguments: list[str]) -> tuple[str, str]:
    """Run a command line in process; return its outcome, and what is wrong with it."""
    from didim.cli.main import main

    out, err = io.StringIO(), io.StringIO()
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("always")
            try:
                code: object = main(arguments)
            except SystemExit as reason:  # of argparse
                code = reason.code
    except KeyboardInterrupt:
        # The alarm came while the process was between two places that hear it.
        return "long", ""
    except BaseException:  # a panic of the core is no Exception
        return "failed", traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    printed = err.getvalue()
    if code == 130:
        return "long", ""
    if code not in (0, 1, 2):
        return "failed", f"exit code {code!r}\n{printed}"
    if any(word in printed for word in ("Traceback", "Warning", "panicked")):
        return "failed", printed
    if code == 2:
        return "refused", wrong_refusal(out.getvalue(), printed)
    return "result", wrong_result()


def wrong_refusal(out: str, printed: str) -> str:
    """What is wrong with the words of a refusal; an empty text when nothing is."""
    if out:
        return f"exit code 2, and a result on stdout\n{out}\n{printed}"
    # What was assumed before the refusal is said in notes, a line each.
    printed = "".join(
        line for line in printed.splitlines(keepends=True) if not line.startswith("didim: note: ")
    )
    if printed.count("\n") != 1 or not printed.startswith("didim: ") or len(printed) < 15:
        return f"exit code 2 without one sentence\n{printed}"
    if len(printed) > LONGEST_SENTENCE:
        return f"a sentence of {len(printed)} characters\n{printed}"
    return ""


def wrong_result() -> str:
    """What is wrong with the JSON of a result; an empty text when nothing is."""
    path = Path("out.json")
    if not path.exists():
        return ""

    def refuse(word: str) -> None:
        raise ValueError(f"{word} is not JSON")

    try:
        json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except ValueError as reason:
        return f"out.json: {reason}"
    return ""


def work(seed: int, numbers: list[int], material: Path, folder: Path, kept: Path) -> None:
    """Run cases in this process, each announced and answered by a line on stdout, until one took more than `FRESH_GB`."""
    import resource

    # Now, so that no case waits for them.
    import scipy.io
    import scipy.signal  # noqa: F401

    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES_GB << 30,) * 2)

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGPROF, interrupt)
    # Whatever shell starts this: a background job has Ctrl-C ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # What the core or C code prints on stderr goes past Python.
    with tempfile.TemporaryFile() as direct:
        os.dup2(direct.fileno(), 2)
        for number in numbers:
            print("begin", number, flush=True)
            outcome, complaint, _ = run_case(folder, material, seed, number)
            if direct.seek(0, os.SEEK_END):
                direct.seek(0)
                complaint += f"\nprinted past Python: {direct.read().decode(errors='replace')}"
                direct.seek(0)
                direct.truncate()
            outcome = "failed" if complaint else outcome
            if outcome != "result" and outcome != "refused":
                keep(folder, kept, number, complaint or "long")
            print("end", number, outcome, flush=True)
            if peak_gb() > FRESH_GB:
                break


def keep(folder: Path, kept: Path, number: int, complaint: str) -> None:
    """Keep the files of a case, and what is wrong with it."""
    target = kept / f"case-{number:05d}"
    shutil.rmtree(target, ignore_errors=True)
    if folder.exists():
        # Links as they are: one may lead to a device without an end.
        shutil.copytree(
            folder,
            target,
            symlinks=True,
            ignore=lambda place, names: [n for n in names if cannot_be_copied(Path(place, n))],
        )
    else:  # the worker has not reached its first case
        target.mkdir(parents=True)
    (target / "complaint.txt").write_text(complaint, encoding="utf-8", errors="backslashreplace")


def cannot_be_copied(path: Path) -> bool:
    """Whether a path is a pipe, or a sparse file that a copy would write out."""
    with contextlib.suppress(OSError):
        return path.is_fifo() or path.lstat().st_size > LARGEST_KEPT
    return False


class Tally:
    """What became of each case, kept in a file as it is known, so that an interrupted run can go on."""

    def __init__(self, path: Path, seed: int, *, resume: bool) -> None:
        lines = path.read_text(encoding="ascii").splitlines() if resume and path.exists() else []
        self.outcomes = {int(number): outcome for number, outcome in map(str.split, lines)}
        self._path, self._seed = path, seed
        self._lock = threading.Lock()
        if not lines:
            path.write_text("", encoding="ascii")

    def count(self, number: int, outcome: str) -> None:
        """Note a case, and print the counts now and then."""
        with self._lock:
            self.outcomes[number] = outcome
            with self._path.open("a", encoding="ascii") as file:
                file.write(f"{number} {outcome}\n")
            if len(self.outcomes) % REPORT_EVERY == 0:
                print(self, flush=True)

    def __str__(self) -> str:
        counts = collections.Counter(self.outcomes.values())
        printed = ", ".join(f"{counts[key]} {key}" for key in OUTCOMES)
        return f"{len(self.outcomes)} cases, seed {self._seed}: {printed}"


class Parent(threading.Thread):
    """Keeps one worker process going through its share of the cases, and ends it when it is deaf."""

    def __init__(
        self, tally: Tally, seed: int, numbers: list[int], material: Path, folder: Path, kept: Path
    ) -> None:
        super().__init__()
        self._tally, self._seed, self._numbers = tally, seed, numbers
        self._places = material, folder, kept

    def run(self) -> None:
        """Start workers until no case is left."""
        left = self._numbers
        while left:
            left = left[self._worker(left) :]

    def _worker(self, numbers: list[int]) -> int:
        """Run one worker; return how many cases are done with."""
        material, folder, kept = self._places
        command = [sys.executable, str(Path(__file__).resolve()), "--worker", str(self._seed)]
        command += [str(place) for place in (material, folder, kept)]
        # One thread: processor time is that of the clock where nobody else computes.
        alone = dict.fromkeys(("DIDIM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **alone},
        )
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(" ".join(map(str, numbers)))
        process.stdin.close()
        done, current, ended = 0, numbers[0], True
        complaint = ""
        with selectors.DefaultSelector() as selector, process:
            selector.register(process.stdout, selectors.EVENT_READ)
            while True:
                # Without a buffer that selectors would not see: a line comes as it is printed.
                if not selector.select(DEAF_S):
                    complaint = f"not heard within {DEAF_S} s"
                    process.kill()
                    break
                line = process.stdout.readline().split()
                if not line:
                    break
                current, ended = int(line[1]), line[0] == "end"
                if ended:
                    done += 1
                    self._tally.count(current, line[2])
        if not ended or complaint or done == 0:
            keep(folder, kept, current, complaint or f"the process ended with {process.returncode}")
            self._tally.count(current, "failed")
            done += 1
        return done


def fuzz(seed: int, numbers: range, jobs: int, *, outputs_too: bool = True, resume: bool = False) -> int:
    """Run all cases, and if asked for those of the outputs, print what became of them, and return the number of failed ones."""
    from fuzz_material import make
    from fuzz_outputs import outputs

    kept = OUTPUT.resolve()
    if not resume:
        shutil.rmtree(kept, ignore_errors=True)
    kept.mkdir(parents=True, exist_ok=True)
    tally = Tally(kept / f"seed-{seed}.txt", seed, resume=resume)
    left = [number for number in numbers if number not in tally.outcomes]
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as scratch:
        material = Path(scratch, "sound")
        material.mkdir()
        os.chdir(material)
        make(material)
        os.chdir(here)
        # Shared out by strides, so that the jobs end together.
        parents = [
            Parent(tally, seed, left[k::jobs], material, Path(scratch, f"case-{k}", "files"), kept)
            for k in range(min(jobs, len(left)))
        ]
        for parent in parents:
            parent.start()
        for parent in parents:
            parent.join()
        unwritten = outputs(material, Path(scratch, "output")) if outputs_too else 0
    print(tally)
    bad = sorted(number for number, outcome in tally.outcomes.items() if outcome == "failed")
    for number in bad:
        print(f"failed: {kept / f'case-{number:05d}'}")
    return len(bad) + unwritten


OUTCOMES = ("result", "refused", "long", "failed")


def command_line() -> int:
    """Read the arguments and run."""
    if sys.argv[1:2] == ["--worker"]:
        material, folder, kept = map(Path, sys.argv[3:6])
        work(int(sys.argv[2]), [int(text) for text in sys.stdin.read().split()], material, folder, kept)
        return 0
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, metavar="CASE", help="number of the first case")
    parser.add_argument(
        "--cases-only", action="store_true", help="leave the outputs alone, for a run in portions"
    )
    parser.add_argument("--resume", action="store_true", help="leave out cases that an earlier run has done")
    options = parser.parse_args()
    numbers = range(options.first, options.first + options.count)
    failed = fuzz(
        options.seed, numbers, options.jobs, outputs_too=not options.cases_only, resume=options.resume
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(command_line())
