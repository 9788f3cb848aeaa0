"""``--help``: short usage, options in groups, examples, lines of readable width. Tested in ``tests/test_terminal.py``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from ..._tools.words import did_you_mean, series
from .color import titled
from .messages import message as print_message
from .width import columns, wrapped

EXAMPLES = "examples:\n"
"""First line of the examples below the options; their line breaks are preserved."""

COMMANDS = {
    "from a log to parameters": ("example", "init", "check", "identify", "validate"),
    "use the parameters": ("export", "simulate", "payload", "residual"),
    "robots and motions": ("robots", "robot", "base", "excite"),
    "methods": ("methods", "compare", "study"),
}
"""Commands by purpose, in the order in which they are needed. Commands that are not listed here follow at the end."""
WIDEST_HELP = 100
"""Largest width of the help (columns); longer lines are hard to read."""


def help_width() -> int:
    """Return the width of the help (columns)."""
    return min(columns() or 80, WIDEST_HELP)


class Formatter(argparse.HelpFormatter):
    """Formatter of help whose usage only names mandatory arguments."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26, width=help_width())

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith(EXAMPLES):
            lines = text.split("\n")
            return "\n".join(part for line in lines for part in wrapped(indent + line, width))
        return super()._fill_text(text, width, indent)


class Parser(argparse.ArgumentParser):
    """Parser whose errors are one line."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self._positionals.title = "arguments"

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; an unknown option is refused first, with the most similar one of this command."""
        words = list(sys.argv[1:] if args is None else args)
        commands = any(isinstance(action, argparse._SubParsersAction) for action in self._actions)
        for word in words:
            # Options after a command belong to it; after -- there are none.
            if word == "--" or (commands and not word.startswith("-")):
                break
            name = word.partition("=")[0]
            known = self._option_string_actions
            if name.startswith("--") and not any(option.startswith(name) for option in known):
                self.error(f"there is no option {name}{did_you_mean(name, known)}")
        return super().parse_known_args(args, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse an invalid choice (commands are choices too), with the most similar one."""
        choices = [str(choice) for choice in action.choices or ()]
        if action.choices is not None and value not in action.choices:
            hint = f"{did_you_mean(str(value), choices)} (there are: {series(choices, 60)})"
            if isinstance(action, argparse._SubParsersAction):
                self.error(f"there is no command {value!r}{hint}")
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}{hint}")

    def error(self, message: str) -> NoReturn:
        """Exit with one line."""
        self.exit(2, f"didim: {message}; see `{self.prog} --help`\n")

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        """Exit, with a message on stderr."""
        if message:
            print_message(message.removeprefix("didim: "))
        sys.exit(status)

    def format_usage(self) -> str:
        """Return the usage: mandatory arguments, and ``[options]`` for all others."""
        return f"usage: {self._usage()}\n"

    def format_help(self) -> str:
        """Return the help."""
        self.usage = self._usage()
        return super().format_help()

    def print_help(self, file: Any = None) -> None:
        """Print the help, with bold titles on a terminal."""
        print(titled(self.format_help()), end="", file=file)

    def _usage(self) -> str:
        formatter = self._get_formatter()
        words = [self.prog, "[options]"]
        for group in self._mutually_exclusive_groups:
            if group.required:
                shown = (
                    f"{action.option_strings[-1]} {action.metavar or ''}".rstrip()
                    for action in group._group_actions
                )
                words.append(f"({' | '.join(shown)})")
        for action in self._actions:
            if action.option_strings:
                if action.required:
                    words += [action.option_strings[0], str(action.metavar)]
            elif isinstance(action, argparse._SubParsersAction):
                words.append("COMMAND ...")
            else:
                words.append(formatter._format_args(action, action.dest))
        lines = wrapped(" ".join(words), help_width() - len("usage: "))
        return f"\n{' ' * len('usage: ')}".join(lines).replace("%", "%%")


class MainParser(Parser):
    """Parser of ``didim`` itself, whose help lists the commands in groups."""

    def format_help(self) -> str:
        """Return the help."""
        width = help_width()
        lines = [f"usage: {self._usage()}", "", *wrapped(str(self.description), width)]
        (commands,) = (action for action in self._actions if isinstance(action, argparse._SubParsersAction))
        sentences = command_sentences(commands)
        known = {name for names in COMMANDS.values() for name in names}
        further = tuple(name for name in sentences if name not in known)
        for title, names in {**COMMANDS, "further": further}.items():
            lines += ["", f"{title}:"]
            lines += listed(((name, sentences[name]) for name in names if name in sentences), width)
        lines += ["", "options:"]
        lines += listed(
            [("-h, --help", "show this help; didim COMMAND --help shows that of a command"),
             ("--version", "show the version")], width
        )  # fmt: skip
        return "\n".join([*lines, "", *str(self.epilog).split("\n")]) + "\n"


def command_sentences(commands: argparse._SubParsersAction[Parser]) -> dict[str, str]:
    """Return the help sentence of each command."""
    return {choice.dest: str(choice.help) for choice in commands._choices_actions}


def listed(rows: Iterable[tuple[str, str]], width: int) -> list[str]:
    """Return names with a sentence each, the sentences aligned in a column."""
    lines: list[str] = []
    for name, text in rows:
        first, *others = wrapped(text, width - 14)
        lines += [f"  {name:10}  {first}", *(" " * 14 + line for line in others)]
    return lines


def examples(commands: Sequence[str]) -> str:
    """Return the text with examples for the end of the help."""
    return EXAMPLES + "\n".join(f"  {command}" for command in commands)
