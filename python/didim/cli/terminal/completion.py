"""``didim completion``: scripts that complete the command line in bash, zsh and fish. Tested in ``tests/test_completion.py``.

The scripts are generated from the parsers and therefore contain all options and choices. Robots and methods are those of the
package.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from ..options import CONVERGED, Commands, add_command, add_option
from .guide import command_sentences


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "completion",
        run,
        "print the script that completes didim on the command line",
        'eval "$(didim completion bash)"              in ~/.bashrc',
        'eval "$(didim completion zsh)"               in ~/.zshrc, after compinit',
        "didim completion fish > ~/.config/fish/completions/didim.fish",
    )
    parser.set_defaults(commands=commands)
    add_option(parser, "shell SHELL", "bash, zsh or fish", choices=tuple(SCRIPTS))


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    print(SCRIPTS[options.shell](list(_commands(options.commands))), end="")
    return CONVERGED


@dataclass(frozen=True)
class Option:
    """One option: its names, the choices of its value (none: a file or another value; None: no value), and its help."""

    names: Sequence[str]
    words: tuple[str, ...] | None
    text: str


@dataclass(frozen=True)
class Command:
    """One command: its options, and the choices of its first argument (none: a file)."""

    name: str
    text: str
    options: tuple[Option, ...]
    words: tuple[str, ...]


def _commands(commands: Commands) -> Iterator[Command]:
    sentences = command_sentences(commands)
    for name, command in commands.choices.items():
        options = tuple(
            Option(
                action.option_strings,
                None if action.nargs == 0 else _words(action),
                _sentence(command, action),
            )
            for action in command._actions
            if action.option_strings
        )
        arguments = [_words(action) for action in command._actions if not action.option_strings]
        yield Command(name, sentences[name], options, arguments[0] if arguments else ())


def _words(action: argparse.Action) -> tuple[str, ...]:
    """Return the known choices of an argument."""
    from ...methods.table import METHODS
    from ...robot.robot_file import PACKAGED

    if action.choices:
        return tuple(map(str, action.choices))
    if action.metavar == "ROBOT" or action.dest == "robot":
        return tuple(sorted(path.stem for path in PACKAGED.glob("*.toml")))
    return tuple(METHODS) if action.dest == "method" else ()


def _sentence(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    """Return the help of an option up to its first clause, with defaults filled in."""
    text = parser._get_formatter()._expand_help(action) if action.help else ""
    return re.split(r" \(|[:;]", text)[0]


def bash(commands: Sequence[Command]) -> str:
    """Return the script for bash; without choices, bash completes files."""
    names = " ".join(command.name for command in commands)
    values, options, first = [], [], []
    for command in commands:
        for option in command.options:
            if option.words is not None:
                places = " | ".join(f'"{command.name} {name}"' for name in option.names)
                words = " ".join(option.words)
                reply = f'COMPREPLY=($(compgen -W "{words}" -- "$cur"))' if words else "COMPREPLY=()"
                values.append(f"        {places}) {reply}; return ;;")
        flags = " ".join(name for option in command.options for name in option.names)
        options.append(f'        {command.name}) words="{flags}" ;;')
        if command.words:
            first.append(f'        {command.name}) words="{" ".join(command.words)}" ;;')
    lines = [
        "# bash completion of didim, written by `didim completion bash`",
        "_didim() {",
        '    local cur="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" words=""',
        "    COMPREPLY=()",
        '    if [ "$COMP_CWORD" -eq 1 ]; then',
        f'        COMPREPLY=($(compgen -W "{names} --help --version" -- "$cur"))',
        "        return",
        "    fi",
        '    case "${COMP_WORDS[1]} $before" in',
        *values,
        "    esac",
        '    if [[ "$cur" == -* ]]; then',
        '        case "${COMP_WORDS[1]}" in',
        *(f"    {line}" for line in options),
        "        esac",
        '    elif [ "$COMP_CWORD" -eq 2 ]; then',
        '        case "${COMP_WORDS[1]}" in',
        *(f"    {line}" for line in first),
        "        esac",
        "    fi",
        '    COMPREPLY=($(compgen -W "$words" -- "$cur"))',
        "}",
        "complete -o default -F _didim didim",
    ]
    return "\n".join(lines) + "\n"


def zsh(commands: Sequence[Command]) -> str:
    """Return the script for zsh."""
    lines = [
        "#compdef didim",
        "# zsh completion of didim, written by `didim completion zsh`",
        "_didim() {",
        "    local -a commands",
        "    commands=(",
        *(f"        {_quoted(f'{command.name}:{command.text}')}" for command in commands),
        "    )",
        "    if (( CURRENT == 2 )); then",
        "        _describe command commands",
        "        return",
        "    fi",
        "    shift words",
        "    (( CURRENT-- ))",
        '    case "$words[1]" in',
    ]
    for command in commands:
        lines += [f"        {command.name})", "            _arguments \\"]
        for option in command.options:
            text = option.text.replace("[", "(").replace("]", ")").replace(":", "\\:")
            for name in option.names:
                value = "" if option.words is None else f":value:{_zsh_values(option.words)}"
                lines.append(f"                {_quoted(f'{name}[{text}]{value}')} \\")
        if command.words:
            lines.append(f"                {_quoted(f'1:value:{_zsh_values(command.words)}')} \\")
        lines += ["                '*:file:_files'", "            ;;"]
    lines += [
        "    esac",
        "}",
        'if [ "$funcstack[1]" = "_didim" ]; then',
        '    _didim "$@"',
        "else",
        "    compdef _didim didim",
        "fi",
    ]
    return "\n".join(lines) + "\n"


def _zsh_values(words: Sequence[str]) -> str:
    return f"({' '.join(words)})" if words else "_files"


def fish(commands: Sequence[Command]) -> str:
    """Return the script for fish; without choices, fish completes files."""
    lines = ["# fish completion of didim, written by `didim completion fish`"]
    lines += [
        f"complete -c didim -n __fish_use_subcommand -f -a {command.name} -d {_quoted(command.text)}"
        for command in commands
    ]
    for command in commands:
        head = f"complete -c didim -n '__fish_seen_subcommand_from {command.name}'"
        if command.words:
            lines.append(f"{head} -a {_quoted(' '.join(command.words))}")
        for option in command.options:
            names = " ".join(
                f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in option.names
            )
            value = "" if option.words is None else " -r"
            if option.words:
                value = f" -x -a {_quoted(' '.join(option.words))}"
            lines.append(f"{head} {names}{value} -d {_quoted(option.text)}")
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """Return a text in single quotes, in which no shell expands anything."""
    return "'" + text.replace("'", "'\\''") + "'"


SCRIPTS: dict[str, Callable[[Sequence[Command]], str]] = {"bash": bash, "zsh": zsh, "fish": fish}
"""Function that writes the completion script, by shell."""
