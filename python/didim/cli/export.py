"""``didim export``."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from .options import CONVERGED, Commands, Options, add_command, add_flag, add_option, refuse, tell
from .outputs import Saved, check_outputs, refuse_existing
from .terminal.width import fitted

NEW = Path()
"""Value of ``--mjcf`` without a file name: a new MJCF is written."""


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "export",
        run,
        "write identified parameters into your URDF or MJCF, or for simulators, as C or LaTeX",
        "didim export fit.json --urdf arm.urdf -o new.urdf",
        "didim export fit.json --mjcf -o arm.xml",
        "didim export fit.json --mjcf go2.xml -o go2_fit.xml --for-step 0.002",
        "didim export fit.json --samples 1000 -o draws.npz",
        "didim export fit.json --c --prefix arm_ -o arm.h",
    )
    add_option(parser, "fit FIT.json", "result of an identification", Path, nargs="?")
    add_option(
        parser,
        "--parameters FILE|NAME",
        "in place of a result: a file of parameters (.toml, .npz), or a parameter set of the robot",
    )
    add_option(
        parser,
        "--prior NAME",
        "prior for parameters that the log does not identify: a parameter set of the robot, or 'generic' solids "
        "(default: the set of the URDF)",
    )
    add_option(
        parser,
        "--robot ROBOT",
        "robot, robot file or URDF (default: the file that the result was made with, beside it or the URDF; the URDF itself)",
    )
    add_option(
        parser,
        "--payload NAME|none",
        "payload of the result that becomes a part of the link which carries it (default: none, and a line says so)",
    )
    _add_forms(parser.add_mutually_exclusive_group(required=True))
    add_option(
        parser,
        "--for-step H",
        "with --mjcf ROBOT.xml, --mjlab, --isaac-lab, --samples: step of the simulator (s), by which its integrator shifts values",
        float,
    )
    parser.add_argument("--prefix", help="with --c: what names begin with (default: the name of the robot)")
    add_option(
        parser,
        "--smoothing V",
        "with --c: velocity (rad/s or m/s) of a tanh in the place of the sign of Coulomb friction",
        float,
    )
    add_flag(
        parser, "--ranges", "with --mjlab and --isaac-lab: events that randomise what was estimated, too"
    )
    parser.add_argument("--seed", type=int, help="with --samples: of NumPy's generator (default: 0)")
    add_option(parser, "-o --output FILE", "new file (default: stdout)", Path)
    add_flag(parser, "--force", "overwrite an existing file")
    add_flag(
        parser,
        "--keep-lumped",
        "in a URDF: links that are fixed to a moving one keep their inertia, and it gets the difference",
    )


def _add_forms(form: Options) -> None:
    """Add the forms, one of which is written."""
    add_option(form, "--urdf ARM.urdf", "URDF whose inertias and friction are replaced", Path)
    add_option(
        form,
        "--mjcf ROBOT.xml",
        "write MJCF, the format of MuJoCo; with a file, change its inertias and drives (of a result on positions: its drives)",
        Path,
        nargs="?",
        const=NEW,
    )
    add_flag(form, "--isaac-lab", "write the actuators of an Isaac Lab articulation")
    add_flag(form, "--mjlab", "write the actuators of an mjlab entity")
    add_option(
        form,
        "--bam ACTUATOR",
        "parameters of BAM's friction model M1, a JSON for each joint, for load_model with BAM's name of the actuator",
        nargs="?",
        const="",
    )
    add_option(
        form,
        "--samples N",
        "write N correlated draws of what was estimated, with ranges: -o NAME.npz or NAME.json",
        int,
    )
    add_flag(form, "--sdf", "write SDF, the format of Gazebo and Drake")
    add_flag(form, "--c", "write a C99 header: torques, M(q) and gravity")
    add_flag(form, "--latex", "write the equations of a robot of up to three joints as LaTeX")


def _wrong(options: argparse.Namespace) -> str | None:
    """Return what is wrong with options together; a result behind --mjcf or --bam is the result."""
    if options.mjcf is not None and options.mjcf.suffix == ".json" and options.fit is None:
        options.fit, options.mjcf = options.mjcf, NEW
    if (options.bam or "").endswith(".json") and options.fit is None:
        options.fit, options.bam = Path(options.bam), ""
    if options.prefix is not None and not options.c:
        return "--prefix is for --c"
    if options.smoothing is not None and not options.c:
        return "--smoothing is for --c"
    if options.ranges and not (options.mjlab or options.isaac_lab):
        return "--ranges is for --mjlab and --isaac-lab"
    if options.seed is not None and options.samples is None:
        return "--seed is for --samples"
    if options.payload is not None and options.fit is None:
        return "--payload is for a result, FIT.json, which has payloads"
    if options.keep_lumped and options.urdf is None:
        return "--keep-lumped is for --urdf"
    steps = (
        options.mjcf not in (None, NEW) or options.isaac_lab or options.mjlab or options.samples is not None
    )
    if options.for_step is not None and not (steps and 0.0 < options.for_step <= 1.0):
        return "--for-step takes a step of up to 1 s, and is for --mjcf ROBOT.xml, --mjlab, --isaac-lab and --samples"
    return None


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..export.code.c_header import to_c
    from ..export.code.latex import to_latex
    from ..export.source import exported_parameters
    from ..export.write import export, into_mjcf
    from ..robot.robot_file import load_robot

    if wrong := _wrong(options):
        return refuse(wrong)
    into = None if options.mjcf == NEW else options.mjcf
    simulators = options.isaac_lab or options.mjlab
    refuse_existing(options.output, force=options.force)
    check_outputs(options.output)
    if options.latex and options.fit is None and options.parameters is None and options.robot is not None:
        return _written(options.output, to_latex(load_robot(options.robot)).encode())
    if (options.fit is None) == (options.parameters is None):
        return refuse("export takes either a result, FIT.json, or --parameters")
    servos = (into or options.urdf) and options.fit is not None and _has_servos(options.fit)
    if options.samples is not None:
        return _samples(options)
    if options.bam is not None:
        return _bam(options)
    if simulators or servos:
        return _drives(options)
    source = exported_parameters(
        fit=options.fit,
        parameters=options.parameters,
        robot=options.robot,
        urdf=into or options.urdf,
        prior=options.prior,
        further_terms=options.c or options.latex,
        payload=options.payload,
    )
    if into:
        content, told, notes = into_mjcf(into, source, options.fit, options.for_step)
        return _written(options.output, content, told, notes)
    if options.c or options.latex:
        text = (
            to_c(source.robot, source.x, prefix=options.prefix, smoothing=options.smoothing)
            if options.c
            else to_latex(source.robot)
        )
        return _written(options.output, text.encode(), notes=source.notes)
    content, report = export(
        source.robot,
        source.x,
        "urdf" if options.urdf is not None else "mjcf" if options.mjcf is not None else "sdf",
        urdf=options.urdf,
        keep_lumped=options.keep_lumped,
        from_prior=source.from_prior,
    )
    return _written(options.output, content, f"{report}", source.notes)


def _has_servos(fit: Path) -> bool:
    """Whether a result is one on positions, with the links of the robot file."""
    from ..result.identification import Identification

    return "positions" in Identification.load(fit).settings


def _drives(options: argparse.Namespace) -> int:
    """Write the drives of a result for a simulator."""
    from ..export.configuration import isaac_lab, mjlab, ranges_of
    from ..export.drives import for_step, read_drives
    from ..export.urdf import edit_dynamics
    from ..export.write import into_mjcf
    from ..result.identification import Identification

    if options.payload is not None:
        return refuse("--payload is for forms with links: a URDF, MJCF, SDF or C of a result on torques")
    if options.fit is None:
        return refuse("drives are exported of a result, FIT.json, and not of --parameters")
    if options.mjcf is not None:
        return _written(options.output, *into_mjcf(options.mjcf, None, options.fit, options.for_step))
    drives, step = read_drives(options.fit).plain_servos(), options.for_step
    if options.urdf is not None:
        content = edit_dynamics(drives, options.urdf)
    else:
        if options.mjlab and step is not None:
            drives = for_step(drives, step, "implicitfast")
        ranges = ranges_of(drives, Identification.load(options.fit).samples()) if options.ranges else None
        content = (mjlab if options.mjlab else isaac_lab)(drives, step, ranges).encode()
    return _written(options.output, content, f"{drives}")


def _bam(options: argparse.Namespace) -> int:
    """Write the parameters of each joint for BAM: of several joints to files with their names."""
    from ..export.configuration import bam
    from ..export.drives import read_drives

    if options.fit is None or options.payload is not None:
        return refuse("--bam is for a result, FIT.json, and for joints without payloads")
    drives = read_drives(options.fit).plain_servos()
    contents = {drive.joint: bam(drive, options.bam).encode() for drive in drives.every}
    if len(contents) == 1:
        return _written(options.output, next(iter(contents.values())), f"{drives}")
    if options.output is None:
        return refuse(
            f"--bam writes {len(contents)} files, one for each joint: -o NAME.json, where NAME_JOINT.json are written"
        )
    saved, paths = Saved(), []
    for joint in contents:
        name = f"{options.output.stem}_{re.sub(r'[^A-Za-z0-9_.-]', '_', joint)}{options.output.suffix}"
        paths.append(options.output.with_name(name))
        refuse_existing(paths[-1], force=options.force)
    check_outputs(*paths)
    for path, content in zip(paths, contents.values(), strict=True):
        saved.write(path, content)
    return saved.end(f"{drives}")


def _samples(options: argparse.Namespace) -> int:
    """Write draws of a result, of links with the prior that its robot has."""
    from ..export.drives import read_drives, samples_for_step
    from ..export.source import fitted_robot
    from ..result.identification import Identification
    from ..result.samples import SUFFIXES

    named = options.output is not None and options.output.suffix in SUFFIXES
    if options.fit is None or options.payload is not None or not named:
        return refuse(
            "--samples is for a result, FIT.json, without payloads, and needs -o NAME.npz or NAME.json"
        )
    fit, more = Identification.load(options.fit), {}
    if options.prior not in (None, "generic"):
        more = {"prior": options.prior, "robot": fitted_robot(fit, options.fit, options.robot)}
    samples, saved = fit.samples(options.samples, seed=options.seed or 0, **more), Saved()
    if options.for_step is not None:
        samples = samples_for_step(samples, read_drives(options.fit), options.for_step)
    saved.save(options.output, samples.save)
    return saved.end(f"{samples}", verdict=fit.verdict)


def _written(path: Path | None, content: bytes, report: str = "", notes: Sequence[str] = ()) -> int:
    """Write a file, or to stdout, then the report and the assumptions."""
    from .._tools.files import write_atomically

    if path is None:
        sys.stdout.buffer.write(content)
        tell(notes)
        if report:
            print(fitted(report), file=sys.stderr)
        return CONVERGED
    saved = Saved()
    saved.save(path, lambda path: write_atomically(path, content))
    if saved.lost:
        sys.stdout.buffer.write(content)
    tell(() if saved.lost else notes)
    parts = [] if saved.failed else [f"{path}: written"]
    return saved.end("\n\n".join([*parts, *([report] if report else [])]))
