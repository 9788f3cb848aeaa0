"""``python -m didim``, and the command ``didim``: Ctrl-C is heard while modules are loaded, too."""

import sys


def main() -> int:
    """Run the command line; return its exit code."""
    try:
        from .cli.main import main as run

        return run()
    except KeyboardInterrupt:
        print("didim: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
