"""`vapor-track completion`."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules
from typing import Literal

import tyro

import vapor.commands
from vapor.commands.command_help import Command
from vapor.commands.console import parse
from vapor.commands.terminal import write

_OFFERED = """\
# What may follow a command and an option, a command, or nothing: a line each.
_vapor_track_offered() {{
  case "$1" in
{cases}
  *) return 1 ;;
  esac
}}
"""

_SCRIPTS = {
    "bash": """\
# Completion of vapor-track in bash.

{offered}
_vapor_track() {{
  local command="" before="" word=${{COMP_WORDS[COMP_CWORD]}}
  if ((COMP_CWORD > 1)); then command=${{COMP_WORDS[1]}}; fi
  if ((COMP_CWORD > 2)); then before=${{COMP_WORDS[COMP_CWORD - 1]}}; fi
  # bash takes --option=value for three words.
  if [ "$word" = = ]; then word=""; elif [ "$before" = = ]; then before=${{COMP_WORDS[COMP_CWORD - 2]}}; fi
  local offered=$(_vapor_track_offered "$command $before" || _vapor_track_offered "$command")
  COMPREPLY=($(compgen -W "$offered" -- "$word"))
}}
complete -o default -F _vapor_track vapor-track  # files where nothing else fits
""",
    "zsh": """\
#compdef vapor-track
# Completion of vapor-track in zsh.

{offered}
_vapor-track() {{
  local command="" before=""
  local -a offered
  if ((CURRENT > 2)); then command=$words[2]; fi
  if ((CURRENT > 3)); then before=$words[CURRENT-1]; fi
  if [[ $words[CURRENT] == --*=* ]]; then before=${{words[CURRENT]%%=*}}; compset -P "$before="; fi
  offered=(${{(f)"$(_vapor_track_offered "$command $before" || _vapor_track_offered "$command")"}})
  compadd -a offered || _files  # where nothing else fits
}}
if [ "$funcstack[1]" = _vapor-track ]; then _vapor-track "$@"; else compdef _vapor-track vapor-track; fi
""",
}


@dataclass(frozen=True)
class Options:
    """Print the script by which a shell completes commands, options, and names that an option takes."""

    shell: tyro.conf.Positional[Literal["bash", "zsh"]]
    """The shell."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    write(completion_script(parse("completion", Options, arguments).shell).rstrip("\n"))


def completion_script(shell: str) -> str:
    """The script for a shell, made from the options of all commands."""
    modules = {
        each.name: import_module(f"vapor.commands.{each.name}") for each in iter_modules(vapor.commands.__path__)
    }
    commands = [Command.of(name, module.Options) for name, module in modules.items() if hasattr(module, "main")]
    lines = [_case([""], [*(command.words for command in commands), "--help", "--version"])]
    lines += [line for command in commands for line in _cases(command)]
    return _SCRIPTS[shell].format(offered=_OFFERED.format(cases="\n".join(lines)))


def _cases(command: Command) -> Iterator[str]:
    options = [option for _, group in command.groups.values() for option in group]
    names = [name for option in options for name in option.names]
    yield _case(
        [command.words],
        [*(name for option in options if not option.names for name in option.choices), *names, "--help"],
    )
    taking = [option for option in options if option.names and option.value]
    for choices in dict.fromkeys(tuple(option.choices) for option in taking):
        after = [f"{command.words} {option.names[0]}" for option in taking if tuple(option.choices) == choices]
        yield _case(after, choices)


def _case(after: Iterable[str], offered: Sequence[str]) -> str:
    printed = [f"printf '%s\\n' {shlex.join(offered)}"] if offered else []
    return " ".join([f"  {' | '.join(map(shlex.quote, after))})", *printed, ";;"])
