"""The commands of docs/first_log.md and docs/new_robot.md run in their order and print what the pages say."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.main import main
from test_documented import indented, tables, words

FRICTION = re.compile(r"# \[friction\]\n(# .*\n)+")
"""Lines on friction that `didim init` writes."""


def run(command: str, code: int = 0) -> None:
    program, *arguments = command.split()
    if program == "cat":
        source, sign, target = arguments
        assert sign == ">>"
        with Path(target).open("a", encoding="utf-8") as file:
            file.write(Path(source).read_text(encoding="utf-8"))
        return
    assert program == "didim"
    assert main(arguments) == code, command


def commands(text: str) -> list[str]:
    return re.findall(r"^    ((?:didim|cat) .*)$", text, flags=re.MULTILINE)


def fences(text: str) -> list[str]:
    return re.findall(r"^```toml\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


def with_friction(path: Path, block: str) -> None:
    text, count = FRICTION.subn(block, path.read_text(encoding="utf-8"))
    assert count == 1
    path.write_text(text, encoding="utf-8")


def replaced(path: Path, before: str, after: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count(f"{before}\n") == 1, before
    path.write_text(text.replace(f"{before}\n", f"{after}\n"), encoding="utf-8")


def same(printed: str, written: str) -> None:
    """Compare text, and its numbers to the rounding of their last digits."""
    number = r"\d+\.\d+"
    assert re.sub(rf" *{number}", " #", printed) == re.sub(rf" *{number}", " #", written)
    for one, other in zip(re.findall(number, printed), re.findall(number, written), strict=True):
        assert float(one) == pytest.approx(float(other), rel=2e-3)


@pytest.mark.slow
def test_from_a_log_to_parameters(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (project / "docs" / "first_log.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    example, *following = commands(text)
    run(example)
    named = capsys.readouterr().out.split("\n\n", 2)[2].splitlines()
    # What the example prints is what the page runs, so that both end in the numbers of the page.
    assert named == ["cd tx40", *following]
    simulate, simulate_other, init, append, check, identify, init_other, append_other, validate = following
    monkeypatch.chdir("tx40")
    run(simulate)
    run(simulate_other)
    capsys.readouterr()
    run(init)
    assert capsys.readouterr().out == indented(text, "how it read the columns:")
    run(append)
    (friction,) = fences(text)
    assert friction in Path("log.toml").read_text(encoding="utf-8")
    run(check)
    assert capsys.readouterr().out == indented(text, f"{check}\n\nprints\n")
    right = (Path("log.toml")).read_text(encoding="utf-8")
    assert right.count('unit = "rad"') == 2
    (Path("log.toml")).write_text(right.replace('unit = "rad"', 'unit = "deg"', 1), encoding="utf-8")
    run(check, code=1)
    same(capsys.readouterr().out, indented(text, "by mistake, it prints\n"))
    (Path("log.toml")).write_text(right, encoding="utf-8")
    run(identify)
    end = text[text.index("and ends with the errors") : text.index("## Validation on another motion")].split(
        "\n\n", 1
    )[1]
    written = "\n".join(line.removeprefix("    ") for line in end.rstrip().splitlines())
    printed = capsys.readouterr().out
    same(printed[printed.index("relative error %") :].rstrip(), written)
    run(init_other)
    run(append_other)
    capsys.readouterr()
    run(validate)
    block = text[text.index("    log, by idim-ls") : text.index("They are nearly as small as on")]
    same(capsys.readouterr().out.rstrip(), "\n".join(line[4:] for line in block.rstrip().splitlines()))


@pytest.mark.slow
def test_a_new_robot_without_python(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = project / "docs" / "new_robot.md"
    text = page.read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    base, simulate, init, check, identify, by_didim = (
        command
        for command in commands(text)
        if command not in ("didim compare", "didim robot tx40 -o my_robot.toml", "didim example tx40")
    )
    run("didim robot tx40 -o my_robot.toml")
    run("didim example tx40")
    rows = tables(page)["line was is"]
    assert len(rows) == 3
    for _, before, after in rows:
        replaced(tmp_path / "my_robot.toml", before, after)
    shutil.copy("tx40/tx40_simulation.toml", "my_simulation.toml")
    replaced(tmp_path / "my_simulation.toml", 'robot = "tx40"', 'robot = "my_robot.toml"')
    for command in (base, simulate, init):
        run(command)
    friction, reference = fences(text)
    with_friction(tmp_path / "my_log.toml", friction)
    run(check)
    run(identify)
    robot = didim.load_robot("my_robot.toml")
    assert (robot.geometry.d[2], robot.geometry.r[3]) == (0.3, 0.25)
    truth = robot.set_base("didim")
    fit = didim.Identification.load("my_fit.json")
    known = fit.relative_std_percent < 2.0
    off = 100.0 * np.max(np.abs(fit.beta / truth - 1.0)[known])
    assert f"{known.sum()} of the 60 parameters have standard deviations below 2 %" in words(page)
    written = re.search(r"are within (\S+) % of the set", words(page))
    assert written is not None
    assert 0.9 * float(written.group(1)) < off < float(written.group(1))

    simulation = Path("my_simulation.toml").read_text(encoding="utf-8")
    loop = simulation[simulation.index("[controller]") : simulation.index("[measurement]")]
    with Path("my_log.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n{reference}\n{loop}")
    run(by_didim)
    fit = didim.Identification.load("my_didim.json")
    rms = float(np.sqrt(np.mean(((fit.beta - truth) / fit.std) ** 2)))
    known = fit.relative_std_percent < 2.0
    assert f"{known.sum()} parameters have standard deviations below 2 %" in words(page)
    assert f"off by {rms:.2f} standard deviations, rms" in words(page)
    # Not because the two robots are alike: with the lengths of the TX40 the same log gives other parameters.
    other = didim.load_robot("tx40")
    assert not np.allclose(other.base_parameters.matrix, robot.base_parameters.matrix)
