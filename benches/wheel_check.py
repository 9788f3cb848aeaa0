"""Is the wheel all that somebody needs who has Python and nothing else?

    python benches/wheel_check.py [WHEEL]

installs the newest wheel of dist/ (`make wheel`) into an empty environment, runs the paper's experiment in an empty folder, with no
Rust and no project on any path, and prints what was installed and how large it is. It fails where the command fails, and
where it imports anything from outside the environment.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

DIST = Path(__file__).resolve().parent.parent / "dist"
PACKAGES = {"didim": ("didim",), "numpy": ("numpy", "numpy.libs"), "scipy": ("scipy", "scipy.libs")}
"""Folders of each package in site-packages."""


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
    kept = {
        key: value for key, value in os.environ.items() if key in ("HOME", "LANG", "TMPDIR", "SYSTEMROOT")
    }
    return {**kept, "PATH": os.pathsep.join([str(binaries), "/usr/bin", "/bin"])}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("wheel", nargs="?", type=Path, help="default: the newest of dist/")
    wheel = (parser.parse_args().wheel or newest_wheel(DIST)).resolve()
    with tempfile.TemporaryDirectory() as folder:
        place, empty = Path(folder) / "environment", Path(folder) / "empty"
        empty.mkdir()
        venv.create(place, with_pip=True)
        binaries = place / ("Scripts" if os.name == "nt" else "bin")
        python = binaries / "python"
        install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel]
        # pip needs the settings of this machine; what is installed is run without them.
        subprocess.run(install, cwd=empty, check=True)
        bare = bare_environment(binaries)
        where = subprocess.run(
            [python, "-c", "import didim; print(didim.__file__)"],
            cwd=empty,
            env=bare,
            check=True,
            capture_output=True,
            text=True,
        ).stdout.strip()
        if not Path(where).is_relative_to(place.resolve()) and not Path(where).is_relative_to(place):
            sys.exit(f"didim is imported from {where}, which is outside the environment")
        done = subprocess.run(
            [binaries / "didim", "compare", "--nelder-mead", "none"],
            cwd=empty,
            env=bare,
            check=False,
            capture_output=True,
            text=True,
        )
        print(done.stdout)
        print(done.stderr, file=sys.stderr)
        left = [path.name for path in empty.iterdir()]
        if done.returncode or left:
            sys.exit(f"didim compare ended with exit code {done.returncode} and left the files {left}")
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB; installed, without __pycache__:")
        packages = Path(where).parent.parent
        sizes = {name: sum(megabytes(packages / part) for part in parts) for name, parts in PACKAGES.items()}
        print(", ".join(f"{name} {size:.1f} MB" for name, size in sizes.items()), end="")
        print(f", together {sum(sizes.values()):.0f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
