"""The command `lagrange completion`: a file that lets a shell complete commands, options, scenes, methods and targets.

The file holds the words. A shell that asks the program for them starts Python each time, which takes 0.1 s and more.
"""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import lagrange as lg
from lagrange.arguments import DONE, Answer, add_command
from lagrange.scenes_command import SCENES

FILES, FOLDERS, SCENE, NOTHING = "files", "folders", "scene", "nothing"
"""What is completed beside words: files, folders, a scene of the library or a file of one, and nothing."""

_BY_METAVAR = {"DIR": FOLDERS, "FILE": FILES, "SCENE": SCENE}

_PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")
"""Words that mean nothing else to any shell."""


@dataclass(frozen=True)
class Option:
    """An option: its name with dashes, a line about it, whether a value follows, and what completes that."""

    name: str
    about: str
    takes_value: bool
    kind: str
    words: tuple[str, ...]


@dataclass(frozen=True)
class Command:
    """A command: a line about it, its options, and what completes words that are no options."""

    name: str
    about: str
    options: tuple[Option, ...]
    kinds: tuple[str, ...]
    words: tuple[str, ...]


def add_completion(commands: Any) -> None:
    """Add the command to the command line; it reads what the others take when it is called."""
    command = add_command(
        commands,
        "completion",
        partial(completion, commands),
        "print a file that lets a shell complete commands, options, scenes and methods",
        takes_scene=False,
    )
    command.add_argument("shell", choices=tuple(SHELLS), help="such as:  source <(lagrange completion bash)")


def completion(commands: Any, request: argparse.Namespace) -> Answer:
    """Return the file for a shell."""
    known = {
        "method": _words(lg.methods.names()),
        "methods": _words(lg.methods.names()),
        "target": _words(dict(lg.targets())),
    }
    found = [_command(name, one, known) for name, one in commands.choices.items()]
    scenes = " ".join(_words(path.stem for path in sorted(SCENES.glob("*.toml"))))
    return Answer(DONE, SHELLS[request.shell](found, scenes))


def _words(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(name for name in names if _PLAIN.fullmatch(name))


def _command(name: str, parser: argparse.ArgumentParser, known: dict[str, tuple[str, ...]]) -> Command:
    options: list[Option] = []
    kinds: list[str] = []
    words: list[str] = []
    for action in parser._actions:
        own = _words(map(str, action.choices)) if action.choices else known.get(action.dest, ())
        kind = _BY_METAVAR.get(str(action.metavar), NOTHING)
        if action.option_strings:
            options.append(Option(action.option_strings[-1], action.help or "", action.nargs != 0, kind, own))
        else:
            kinds.append(kind)
            words += own
    return Command(name, (parser.description or "").rstrip("."), tuple(options), tuple(kinds), tuple(words))


# --- bash -------------------------------------------------------------------------------------------------------

_BASH = """\
# Completion of lagrange in bash, for this shell:  source <(lagrange completion bash)
# and for those to come:  lagrange completion bash > ~/.local/share/bash-completion/completions/lagrange
_lagrange_words() {{ mapfile -t -O "${{#COMPREPLY[@]}}" COMPREPLY < <(compgen "$@" -- "$current"); }}
_lagrange() {{
    local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}"
    local scenes='{scenes}'
    COMPREPLY=()
    if ((COMP_CWORD == 1)); then _lagrange_words -W '{commands} --help --version'; return; fi
    case "${{COMP_WORDS[1]}}:$before" in
{values}
    esac
    case "${{COMP_WORDS[1]}}:$current" in
{rest}
    esac
}}
complete -F _lagrange lagrange"""

_BASH_KINDS = {
    FILES: "compopt -o filenames; _lagrange_words -f",
    FOLDERS: "compopt -o filenames; _lagrange_words -d",
    SCENE: "compopt -o filenames; _lagrange_words -W \"$scenes\"; _lagrange_words -f -X '!*.toml'; _lagrange_words -d",
}


def _bash(commands: list[Command], scenes: str) -> str:
    values, rest = [], []
    for command in commands:
        for option in command.options:
            if option.takes_value:
                act = f"_lagrange_words -W '{' '.join(option.words)}'" if option.words else _BASH_KINDS.get(option.kind)
                values.append(f"        {command.name}:{option.name}) {f'{act}; ' if act else ''}return ;;")
        rest.append(
            f"        {command.name}:-*) _lagrange_words -W '{' '.join(option.name for option in command.options)}' ;;"
        )
        acts = [_BASH_KINDS[kind] for kind in command.kinds if kind in _BASH_KINDS]
        acts += [f"_lagrange_words -W '{' '.join(command.words)}'"] if command.words else []
        rest += [f"        {command.name}:*) {'; '.join(acts)} ;;"] if acts else []
    names = " ".join(command.name for command in commands)
    return _BASH.format(scenes=scenes, commands=names, values="\n".join(values), rest="\n".join(rest))


# --- zsh --------------------------------------------------------------------------------------------------------

_ZSH = """\
#compdef lagrange
# Completion of lagrange in zsh, for this shell:  source <(lagrange completion zsh)
# and for those to come:  lagrange completion zsh > "${{fpath[1]}}/_lagrange"
_lagrange() {{
    local -a scenes=({scenes})
    local -a names=(
{commands}
    )
    if ((CURRENT == 2)); then _describe command names; compadd -- --help --version; return; fi
    case "$words[2]:$words[CURRENT-1]" in
{values}
    esac
    case "$words[2]:$PREFIX" in
{rest}
    esac
}}
if [[ "$funcstack[1]" == "_lagrange" ]]; then _lagrange "$@"; else compdef _lagrange lagrange; fi"""

_ZSH_KINDS = {FILES: "_files", FOLDERS: "_files -/", SCENE: "compadd -a scenes; _files -g '*.toml'"}


def _zsh(commands: list[Command], scenes: str) -> str:
    values, rest, names = [], [], []
    for command in commands:
        names.append(f"        {shlex.quote(f'{command.name}:{command.about}')}")
        for option in command.options:
            if option.takes_value:
                act = f"compadd -- {' '.join(option.words)}" if option.words else _ZSH_KINDS.get(option.kind)
                values.append(f"        ({command.name}:{option.name}) {f'{act}; ' if act else ''}return ;;")
        own = [shlex.quote(f"{option.name}:{option.about}") for option in command.options]
        rest.append(f"        ({command.name}:-*) local -a flags=({' '.join(own)}); _describe -o option flags ;;")
        acts = [_ZSH_KINDS[kind] for kind in command.kinds if kind in _ZSH_KINDS]
        acts += [f"compadd -- {' '.join(command.words)}"] if command.words else []
        rest += [f"        ({command.name}:*) {'; '.join(acts)} ;;"] if acts else []
    return _ZSH.format(scenes=scenes, commands="\n".join(names), values="\n".join(values), rest="\n".join(rest))


# --- fish -------------------------------------------------------------------------------------------------------

_FISH_KINDS = {
    FILES: "-r -F",
    FOLDERS: "-x -a '(__fish_complete_directories)'",
    SCENE: "-x -a '(__fish_complete_suffix .toml)'",
}


def _fish(commands: list[Command], scenes: str) -> str:
    lines = [
        "# Completion of lagrange in fish, for this shell:  lagrange completion fish | source",
        "# and for those to come:  lagrange completion fish > ~/.config/fish/completions/lagrange.fish",
        f"set -g __lagrange_scenes {scenes}",
        "complete -c lagrange -f",
        "complete -c lagrange -n __fish_use_subcommand -l help -d 'Show the commands'",
        "complete -c lagrange -n __fish_use_subcommand -l version -d 'Show the version'",
    ]
    for command in commands:
        lines.append(f"complete -c lagrange -n __fish_use_subcommand -a {command.name} -d {_quoted(command.about)}")
        within = f"complete -c lagrange -n '__fish_seen_subcommand_from {command.name}'"
        for option in command.options:
            value = _FISH_KINDS.get(option.kind, "-x") if option.takes_value else ""
            value = f"-x -a '{' '.join(option.words)}'" if option.words else value
            lines.append(f"{within} -l {option.name.lstrip('-')} {value} -d {_quoted(option.about)}".replace("  ", " "))
        if SCENE in command.kinds:
            lines += [f"{within} -a '$__lagrange_scenes'", f"{within} -k -a '(__fish_complete_suffix .toml)'"]
        lines += [f"{within} -F"] if FILES in command.kinds else []
        lines += [f"{within} -a '{' '.join(command.words)}'"] if command.words else []
    return "\n".join(lines)


def _quoted(text: str) -> str:
    """Return a text in quotes of fish."""
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


SHELLS = {"bash": _bash, "zsh": _zsh, "fish": _fish}
"""What writes the file for each shell."""
