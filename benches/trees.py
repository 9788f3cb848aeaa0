"""Random trees against Pinocchio, more of them than the tests take: models to 1e-9, base parameters equal to the numerical rank.

    python benches/trees.py [--trees 500]

runs tests of ``tests/test_trees.py`` and ``tests/test_couplings.py`` for more seeds: trees of 2 to 40 joints that turn or slide,
with rotors and gravity in any direction, trees with coupled joints, and the number of base parameters of trees of 2 to 14 joints.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import test_couplings
import test_trees

CHECKS = {
    "models": test_trees.test_random_trees_have_the_models_of_pinocchio,
    "models of coupled trees": test_couplings.test_models_are_those_of_pinocchio_seen_by_the_driven_joints,
    "base parameters": test_trees.test_base_parameters_are_as_many_as_the_numerical_rank_says,
    "base parameters of coupled trees": test_couplings.test_base_parameters_are_as_many_as_the_numerical_rank_says,
}


def main() -> int:
    parser = argparse.ArgumentParser(description="Random trees against Pinocchio.")
    parser.add_argument("--trees", type=int, default=500, help="random trees (default: %(default)s)")
    trees = parser.parse_args().trees
    failed = 0
    for name, check in CHECKS.items():
        wrong = []
        for seed in range(trees):
            with tempfile.TemporaryDirectory() as folder:
                try:
                    check(Path(folder), seed)
                except AssertionError:
                    wrong.append(seed)
        print(f"{name}: {trees - len(wrong)} of {trees} trees agree", *wrong[:10], flush=True)
        failed += len(wrong)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
