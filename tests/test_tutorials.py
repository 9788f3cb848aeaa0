"""The commands of docs/first_log.md, robots.md, tool.md and studies.md run in their order and print what the pages say."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest

import didim
from didim.cli.lists import example_commands
from didim.cli.main import main
from test_documented import indented, tables, words

FRICTION = re.compile(r"# \[friction\]\n(# .*\n)+")
"""Lines on friction that `didim init` writes."""


def run(command: str, code: int = 0) -> None:
    program, *arguments = command.split()
    if program == "python":
        (path,) = arguments
        runpy.run_path(path, run_name="__main__")
        return
    if program == "cat":
        source, sign, target = arguments
        assert sign == ">>"
        with Path(target).open("a", encoding="utf-8") as file:
            file.write(Path(source).read_text(encoding="utf-8"))
        return
    assert program == "didim"
    assert main(arguments) == code, command


def section(page: Path, title: str) -> str:
    """Return the text of a page below a heading, to the next one of its kind."""
    return page.read_text(encoding="utf-8").partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def commands(text: str) -> list[str]:
    return re.findall(r"^    ((?:didim|cat|python) .*)$", text, flags=re.MULTILINE)


def walked(name: str, text: str, folder: Path) -> dict[str, str]:
    """Run the commands of the page of an example in an empty folder; return what each of the example's prints."""
    example, *following = commands(text)
    assert example == f"didim example {name}"
    assert following == example_commands(name)
    printed = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run(example)
        patch.chdir(name)
        for command in following:
            with contextlib.redirect_stdout(io.StringIO()) as out:
                run(command)
            printed[command] = out.getvalue()
    return printed


def ends_sound(printed: str) -> bool:
    return printed.rstrip().rpartition("\n")[2].startswith("Verdict: sound: ")


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
    page = project / "docs" / "robots.md"
    text = section(page, "A new robot, without Python")
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


@pytest.mark.slow
def test_a_gripper_from_two_logs(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = project / "docs" / "tool.md"
    text = section(page, "A gripper, from two logs")
    printed = walked("payload", text, tmp_path)
    assert printed["didim check free.toml"] == "free: nothing found.\n"
    fits = [
        out for command, out in printed.items() if command.startswith(("didim identify", "didim payload"))
    ]
    assert [ends_sound(out) for out in fits] == [True, True, True]
    fit = didim.Identification.load(tmp_path / "payload" / "fit.json")
    assert f"relative error is {100.0 * fit.overall_relative_error:.3f} %" in text
    rows = tables(page)[" estimate 95 % low"]
    shown = [line for line in fits[1].splitlines() if line.startswith(("mass ", "centre "))][:4]
    assert len(rows) == len(shown) == 4
    for row, line in zip(rows, shown, strict=True):
        estimate, low, high, truth = map(float, row[1:])
        found = [float(cell) for cell in (line.split()[-4], *line.split()[-2:])]
        assert found == pytest.approx([estimate, low, high], abs=6e-4 if row[0].startswith("mass") else 0.06)
        assert low <= truth <= high
    further = didim.Identification.load(tmp_path / "payload" / "both.json").further
    assert further is not None
    assert f"a mass of {further.values[further.names.index('gripper.M')]:.3f} kg" in words(page)
    monkeypatch.chdir(tmp_path / "payload")
    capsys.readouterr()
    run("didim export both.json --mjcf --payload none -o tx40.xml")
    with_gripper, without = (
        float(re.findall(r"^link6 +(\S+)", out, flags=re.MULTILINE)[0])
        for out in ([*printed.values()][-1], capsys.readouterr().out)
    )
    assert with_gripper - without == pytest.approx(0.8, abs=0.01)


@pytest.mark.slow
def test_two_methods_and_two_encoders(project: Path, tmp_path: Path) -> None:
    page = project / "docs" / "studies.md"
    text = section(page, "Two methods and two encoders")
    printed = walked("study", text, tmp_path)
    *_, check, identify = printed.values()
    assert check == "log: nothing found.\n"
    assert ends_sound(identify)
    assert float(re.findall(r"^fit .* (\S+)$", identify, flags=re.MULTILINE)[0]) == pytest.approx(
        float(re.findall(r"relative error is (\S+) %", text)[0]), abs=0.002
    )
    first, again, *_ = printed.values()
    assert "80 runs, 0 failed" in first
    found: dict[tuple[float, str], list[float]] = {}
    for block in again.split("measurement.position_noise_rad = ")[1:]:
        for method, bias, rms in re.findall(
            r"^  (\S+) +(\S+) \[\S+ \S+ +(\S+) \[", block, flags=re.MULTILINE
        ):
            found[float(block.split()[0]), method] = [float(bias), float(rms)]
    rows = tables(page)["encoder noise (rad) method bias"]
    assert len(rows) == len(found) == 4
    for noise, method, bias, rms in rows:
        assert found[float(noise), method.lower()] == pytest.approx([float(bias), float(rms)], abs=0.02)
    # What the page concludes: the regression along measured positions is biased by the coarse encoder alone.
    assert found[1e-3, "idim-ls"][0] > 2.0 * max(found[1e-3, "didim"][0], found[1e-5, "idim-ls"][0])
