"""Is the wheel all that somebody needs who has Python and nothing else?

    python benches/wheel_check.py [WHEEL] [--contract] [--python PYTHON | FOLDER:PYTHON ...]

installs the newest wheel of dist/ (`make wheel`) into an empty environment of each interpreter, runs every example with all its
commands and the paper's experiment in an empty folder, with no Rust and no project on any path, and prints what was installed and
how large it is. Examples that need an extra run last, with it; where pip cannot install it, the output says that they did not run.
It fails where a command fails, where anything is imported from outside the environment, where the core asks
for a later glibc than the name of the wheel says, where the licence of a Rust package inside, or the SBOM, is missing, and where a
file of the wheel tells in which folder it was built. `--contract` also runs the contract suite of the methods there.

`FOLDER:PYTHON` is an interpreter in the root of another system, entered by chroot (as root):

    debootstrap --include=python3-venv,ca-certificates bookworm /tmp/bookworm
    python benches/wheel_check.py --python /tmp/bookworm:/usr/bin/python3

With qemu-user-static and binfmt-support the system may be one of another processor:

    make wheel TARGET=aarch64-unknown-linux-gnu
    debootstrap --arch=arm64 --include=python3-venv,ca-certificates bookworm /tmp/arm64
    python benches/wheel_check.py --contract --python /tmp/arm64:/usr/bin/python3
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

DIST = Path(__file__).resolve().parent.parent / "dist"
TESTS = DIST.parent / "tests"
CONTRACT = ("conftest.py", "contract.py", "test_contract.py")
"""Files of the contract suite."""
PACKAGES = {"didim": ("didim",), "numpy": ("numpy", "numpy.libs"), "scipy": ("scipy", "scipy.libs")}
"""Folders of each package in site-packages."""
SYSTEM = """
import platform, numpy, scipy
try:
    system = platform.freedesktop_os_release()["PRETTY_NAME"]
except (OSError, KeyError):
    system = platform.system()
python = platform.python_implementation(), platform.python_version(), *platform.libc_ver()
print(*python, "of", system, platform.machine(), "numpy", numpy.__version__, "scipy", scipy.__version__)
"""
MUST_TRAVEL = ("faer", "nalgebra", "numpy", "pyo3", "simba")
"""Packages that make up most of the core, under MIT, Apache-2.0 and BSD-2-Clause."""
EXTRA = re.compile(r"didim\[(\w+)\]")
"""The extra of the package that the README of an example names."""
GLIBC = re.compile(rb"GLIBC_2\.(\d+)")


class Place(NamedTuple):
    """An interpreter, and the root of the system that it belongs to."""

    python: str
    root: Path | None = None

    @classmethod
    def named(cls, name: str) -> Place:
        """Read ``PYTHON`` or ``FOLDER:PYTHON``."""
        root, colon, python = name.rpartition(":")
        return cls(python, Path(root)) if colon else cls(python)

    def command(self, *words: object) -> list[str]:
        """Return a command as it is called from here."""
        # By its path: the variables that commands run with have none for administrators.
        program = shutil.which("chroot") or "/usr/sbin/chroot"
        chroot = [] if self.root is None else [program, str(self.root)]
        return [*chroot, *(str(word) for word in words)]

    def here(self, path: Path) -> Path:
        """Return where a path of the place is for this process."""
        return path if self.root is None else self.root / path.relative_to("/")


def newest_wheel(folder: Path) -> Path:
    """Return the wheel that was made last."""
    wheels = sorted(folder.glob("didim-*.whl"), key=lambda path: path.stat().st_mtime)
    if not wheels:
        sys.exit(f"there is no wheel in {folder}: `make wheel` makes one")
    return wheels[-1]


def megabytes(folder: Path) -> float:
    """Size of the files in a folder, without what Python compiles."""
    files = (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return sum(path.stat().st_size for path in files) / 1e6


def bare_environment(binaries: Path) -> dict[str, str]:
    """Return variables without Rust, without paths of Python, and with no other programs than those of the system."""
    kept = {key: value for key, value in os.environ.items() if key in ("HOME", "LANG", "TMPDIR")}
    return {**kept, "PATH": os.pathsep.join([str(binaries), "/usr/bin", "/bin"])}


def glibc(wheel: Path) -> tuple[int, int | None]:
    """Return the second number of the latest glibc that the core asks for, and of the one that the wheel is named after."""
    with zipfile.ZipFile(wheel) as archive:
        cores = [archive.read(name) for name in archive.namelist() if re.search(r"_core\.[^/]*so$", name)]
    asked = max(int(number) for core in cores for number in GLIBC.findall(core))
    named = re.search(r"manylinux_2_(\d+)_", wheel.name)
    return asked, int(named.group(1)) if named else None


def unlicensed(wheel: Path) -> list[str]:
    """Return the packages of the wheel's SBOM whose licence asks for its text, and whose text does not travel with the wheel.

    Raises
    ------
    SystemExit
        When the wheel has no SBOM, or no file of third-party licences.
    """
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        sboms = [name for name in names if re.search(r"\.dist-info/sboms/.*\.json$", name)]
        texts = [name for name in names if name.endswith(".dist-info/licenses/THIRD_PARTY_LICENSES.txt")]
        if not sboms or not texts:
            raise SystemExit(
                f"{wheel.name} has {'no SBOM' if not sboms else 'no licences of its Rust packages'}"
            )
        components = json.loads(archive.read(sboms[0]))["components"]
        text = archive.read(texts[0]).decode()
    # Packages under MIT or Apache-2.0 that only build scripts and tests use stand in the SBOM, and are not in the core.
    return [
        f"{item['name']} {item['version']}"
        for item in components
        if item["name"] in MUST_TRAVEL and f"{item['name']} {item['version']}: " not in text
    ]


def naming_folders(wheel: Path) -> list[str]:
    """Return the files of the wheel that name a folder of the machine that built it: the project, or the Rust packages."""
    cargo = os.environ.get("CARGO_HOME", str(Path.home() / ".cargo"))
    folders = [os.fsencode(folder) for folder in (f"{DIST.parent}/", f"{cargo}/registry/")]
    with zipfile.ZipFile(wheel) as archive:
        return [name for name in archive.namelist() if any(path in archive.read(name) for path in folders)]


def run(
    place: Place, folder: Path, environment: dict[str, str], words: Sequence[object]
) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder of the place."""
    inside = ["sh", "-c", 'cd "$0" && exec "$@"', folder, *words]
    return subprocess.run(
        place.command(*inside), env=environment, check=False, capture_output=True, text=True
    )


def check(wheel: Path, place: Place, contract: bool = False) -> None:
    """Install the wheel in a place and use it; `contract`: run the contract suite too."""
    base = place.here(Path("/tmp"))
    folder = Path(tempfile.mkdtemp(prefix="wheel-check-", dir=base))
    try:
        inside = folder if place.root is None else Path("/tmp") / folder.name
        environment, empty = inside / "environment", inside / "empty"
        (folder / "empty").mkdir()
        shutil.copy(wheel, folder)
        # pip needs the settings of this machine; what is installed is run without them.
        subprocess.run(place.command(place.python, "-m", "venv", environment), check=True)
        python = environment / "bin" / "python"
        install(place, python, inside / wheel.name)
        bare = bare_environment(environment / "bin")
        print(run(place, empty, bare, [python, "-c", SYSTEM]).stdout.strip())
        where = run(place, empty, bare, [python, "-c", "import didim; print(didim.__file__)"]).stdout.strip()
        if not Path(where).is_relative_to(environment.resolve()) and not Path(where).is_relative_to(
            environment
        ):
            sys.exit(f"didim is imported from {where}, which is outside the environment")
        run_examples(place, empty, bare, python, inside / wheel.name)
        print(succeed(place, empty, bare, ["didim", "compare", "--nelder-mead", "none"]))
        left = [path.name for path in (folder / "empty").iterdir()]
        if left:
            sys.exit(f"didim compare left the files {left}")
        if contract:
            install(place, python, "pytest", "hypothesis")
            (folder / "tests").mkdir()
            for name in CONTRACT:
                shutil.copy(TESTS / name, folder / "tests")
            pytest = [python, "-m", "pytest", "-q", "-W", "error", "-p", "no:cacheprovider", inside / "tests"]
            print("contract suite:", succeed(place, empty, bare, pytest).splitlines()[-1])
        packages = place.here(Path(where).parent.parent)
        sizes = {name: sum(megabytes(packages / part) for part in parts) for name, parts in PACKAGES.items()}
        print(
            "installed, without __pycache__:",
            ", ".join(f"{name} {size:.1f} MB" for name, size in sizes.items()),
            end="",
        )
        print(f", together {sum(sizes.values()):.0f} MB\n", flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run_examples(place: Place, empty: Path, bare: dict[str, str], python: Path, wheel: Path) -> None:
    """Run all commands of every example in an empty folder; those that need an extra come last, after its installation."""
    listed = succeed(place, empty, bare, ["didim", "example"])
    examples = []
    for name in re.findall(r"^(\w+)  ", listed, flags=re.MULTILINE):
        printed = succeed(place, empty, bare, ["didim", "example", name])
        commands = printed.partition(f"\ncd {name}\n")[2].splitlines()
        if not commands:
            sys.exit(f"didim example {name} names no commands:\n{printed}")
        needed = EXTRA.search(place.here(empty / name / "README.md").read_text(encoding="utf-8"))
        examples.append((needed.group(1) if needed else "", name, commands))

    def use(name: str, commands: list[str], needs: str) -> str:
        start = time.perf_counter()
        for command in commands:
            succeed(place, empty / name, bare, ["sh", "-c", command])
        return f"  {name}: {len(commands)} commands{needs}, {time.perf_counter() - start:.0f} s"

    # Beside each other: a command has one process.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for extra, some in itertools.groupby(sorted(examples), key=lambda example: example[0]):
            if extra and (failure := installation(place, python, f"{wheel}[{extra}]")):
                why = f"pip cannot install didim[{extra}] here: {failure.splitlines()[-1]}"
                print("\n".join(f"  {name}: NOT RUN, {why}" for _, name, _ in some))
                continue
            needs = f" with didim[{extra}]" if extra else ""
            used = [pool.submit(use, name, commands, needs) for _, name, commands in some]
            print("\n".join(one.result() for one in used))
    for _, name, _ in examples:
        shutil.rmtree(place.here(empty / name))


def install(place: Place, python: Path, *packages: object) -> None:
    """Install packages in the environment of an interpreter, or end."""
    failure = installation(place, python, *packages)
    if failure:
        sys.exit(f"pip cannot install {' '.join(map(str, packages))}: {failure}")


def installation(place: Place, python: Path, *packages: object) -> str:
    """Install packages in the environment of an interpreter, and return what pip says where it fails."""
    settings = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    words = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages]
    done = run(place, Path("/"), settings, words)
    return (done.stderr.strip() or f"exit code {done.returncode}") if done.returncode else ""


def succeed(place: Place, folder: Path, environment: dict[str, str], words: Sequence[object]) -> str:
    """Run a command that has to end well, and return what it printed."""
    done = run(place, folder, environment, words)
    if done.returncode:
        sys.exit(
            f"{' '.join(map(str, words))} ended with exit code {done.returncode}:\n{done.stdout}{done.stderr}"
        )
    return done.stdout


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("wheel", nargs="?", type=Path, help="default: the newest of dist/")
    parser.add_argument("--contract", action="store_true", help="run the contract suite of the methods too")
    parser.add_argument(
        "--python",
        nargs="+",
        default=[sys.executable],
        help="interpreters, those of other systems as FOLDER:PYTHON",
    )
    options = parser.parse_args()
    wheel = (options.wheel or newest_wheel(DIST)).resolve()
    asked, named = glibc(wheel)
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB; needs glibc 2.{asked}")
    if named is not None and asked > named:
        sys.exit(f"the name of the wheel promises glibc 2.{named}, and its core needs 2.{asked}")
    missing = unlicensed(wheel)
    if missing:
        sys.exit(f"the licence of {missing[0]} does not travel with the wheel: python benches/licences.py")
    files = naming_folders(wheel)
    if files:
        sys.exit(f"{files[0]} names a folder of the machine that built the wheel")
    for name in options.python:
        check(wheel, Place.named(name), options.contract)
    return 0


if __name__ == "__main__":
    sys.exit(main())
