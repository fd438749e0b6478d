"""The messages about wrong words on the command line: what to type instead, for all commands and studies."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click
from click.core import ParameterSource

from desim.config.errors import ArgumentError, KeyedError, NoMetricError
from desim.config.suggestion import close_to

_FOREIGN_OPTIONS = {
    "--jobs": "cores cpus parallel processes threads workers",
    "--metric": "y",
    "--out": "dir folder outdir output",
    "--runs": "count n-runs num-runs repetitions reps seeds",
    "--y": "metric",
}
OPTIONS: Mapping[str, str] = {word: option for option, words in _FOREIGN_OPTIONS.items() for word in words.split()}
"""Options of other programs, without their hyphens, each with the option of desim that it means."""
_FOREIGN_COMMANDS = {
    "check": "validate",
    "compare": "diff",
    "ls": "list",
    "new": "create init",
    "play": "gui show web",
    "plot": "draw",
    "plot FILE --kind film": "animate film gif movie video",
    "run": "simulate start",
    "--help": "help",
    "--version": "version",
}
COMMANDS: Mapping[str, str] = {word: command for command, words in _FOREIGN_COMMANDS.items() for word in words.split()}
"""Commands of other programs, each with the command of desim that it means."""
NEEDED: Mapping[str, str] = MappingProxyType(
    {
        "a": "the folder of a sweep, which `desim sweep FILE -o DIR` writes",
        "dir": "a folder with results, which `desim run`, `sweep` and others write with -o DIR",
        "file": "a scenario file; `desim examples relay` writes relay.toml, for instance",
        "folder": "the folder of a sweep, which `desim sweep FILE -o DIR` writes",
        "key": "a key of the grid, network.latency.value for instance",
        "log": "a CSV or Parquet file with the columns t, src, dst and size",
        "name": "the name of what is written, my_rule for instance",
        "stores": "the folders of the sweeps to merge",
        "to": "the file to write, runs.csv for instance; its suffix sets the format",
    }
)
"""What an argument is, by the last part of its name in the usage of a command."""
WORDS = "desim.words"
"""The key of the words of the command line in the context of a command."""
ARGUMENT = re.compile(r"`(\w+)`")
"""Matches an argument of a function in the message of an error."""


def no_command(word: str) -> str | None:
    """Return the message for a word in place of a command; None if nothing is known about the word."""
    if word in COMMANDS:
        return f"No such command {word!r}. Did you mean 'desim {COMMANDS[word]}'?"
    if word.endswith(".py"):
        return f"No such command {word!r}. A script is run by Python: python {word}"
    if word.endswith(".toml") or is_file(word):
        return f"No such command {word!r}. To run a scenario file, type: desim run {word}"
    return None


def is_file(word: str | Path) -> bool:
    """Return whether a word of the command line is the path of a file."""
    try:
        return Path(word).is_file()
    except OSError:  # a name of more than 255 bytes, or a folder without permission
        return False


def advised(
    error: click.UsageError, words: Sequence[str] = (), program: click.Context | None = None
) -> click.UsageError:
    """Return an error whose message says what to type instead; the error itself if that is not known.

    Args:
        error: the error.
        words: the words after the name of the command.
        program: the context of the program, for an error that has no context.
    """
    context = error.ctx or _context_of(words, program)
    if isinstance(error, click.NoSuchOption):
        return _about_option(error, words)
    if isinstance(error, click.MissingParameter) and error.param is not None and context is not None:
        return click.UsageError(f"needs {_described(error.param, context)}", context)
    if isinstance(error, click.BadOptionUsage) and context is not None:
        option = next((param for param in context.command.params if error.option_name in param.opts), None)
        return error if option is None else click.UsageError(f"{error.message} {_described(option, context)}", context)
    if type(error) is click.BadParameter and error.param is not None:
        message = _about_value(error.message, error.param)
        return click.BadParameter(message, error.ctx, error.param, error.param_hint)
    if type(error) is click.UsageError and context is not None and error.message.startswith("Got unexpected extra"):
        return click.UsageError(f"{error.message}: {_accepted_arguments(context, error.message)}", context)
    return error


def _context_of(words: Sequence[str], program: click.Context | None) -> click.Context | None:
    """Return a context of the command that is typed after the name of a program, or else that of the program."""
    group = program and program.command
    name = next((word for word in words if isinstance(group, click.Group) and word in group.commands), None)
    if name is None or not isinstance(group, click.Group):
        return program
    return click.Context(group.commands[name], program, info_name=name)


def check_hyphens(words: Iterable[str], context: click.Context) -> None:
    """Raise UsageError if a long option has one hyphen: -seed would be read as -s with the value "eed".

    Args:
        words: the words after the name of the program.
        context: a context of the program.
    """
    command, options = context.command, {"--help"}
    for word in words:
        if word == "--":
            return
        if isinstance(command, click.Group) and word in command.commands:
            command = command.commands[word]
        # An option such as --y is left out: with one hyphen it is the short option -y.
        options |= {name for param in command.params for name in param.opts if len(name) > len("--y")}
        name = word.partition("=")[0]
        if f"-{name}" in options and not name.startswith("--"):
            inner = context if command is context.command else click.Context(command, context, info_name=command.name)
            raise click.UsageError(f"No such option {name!r}. Did you mean '-{name}'?", inner)


def check_empty(words: Sequence[str], context: click.Context) -> None:
    """Raise UsageError if the value of an option is empty: -o "$OUT" without OUT would mean the working folder.

    The arguments are those of `check_hyphens`.
    """
    for before, word in zip(("", *words), words, strict=False):
        option, equals, value = word.partition("=") if word.startswith("--") else (before, "", word)
        if option.startswith("-") and not value and (equals or not word):  # "--out=", or "" after an option
            raise click.UsageError(f"The value of {option} is empty. Is a variable of the shell not set?", context)


def _described(param: click.Parameter, context: click.Context) -> str:
    """Return a parameter as the usage of its command spells it, and its meaning."""
    form = param.make_metavar(context)
    if isinstance(param, click.Option):
        return f"{min(param.opts, key=len)} {form}: {_purpose(param)}."
    if len(choices := getattr(param.type, "choices", ())):
        return f"one of {', '.join(choices)}"
    last = form.replace("...", "").replace("|", " ").split()[-1].lower().strip("[]{}")
    meaning = NEEDED.get(last, NEEDED["a"])  # B of `desim compare` is a folder like A
    if form == "DIR|FILE" or form.startswith("DIR|FILE "):
        meaning = f"{NEEDED['dir']}, or a scenario file"
    return f"{form}: {meaning}"


def _purpose(param: click.Parameter) -> str:
    """Return the first sentence of the help of an option, without its full stop; "" if there is none."""
    return re.split(r"\. (?=[A-Z])", getattr(param, "help", None) or "")[0].rstrip(".")


def _accepted_arguments(context: click.Context, message: str) -> str:
    """Return the arguments that a command takes, and how to quote them if the message is about a KEY=VALUE."""
    forms = [param.make_metavar(context) for param in context.command.params if isinstance(param, click.Argument)]
    text = f"{context.command_path} takes {' '.join(forms) or 'options only'}"
    if "=" not in message:
        return text
    return f"{text}; a value with spaces, braces or brackets is in quotes: --set 'fault=[{{kind = \"crash\", ...}}]'"


def _about_option(error: click.NoSuchOption, words: Sequence[str]) -> click.NoSuchOption:
    """Return the error about a wrong option, with the option, or the key of a scenario, that the user may mean.

    The surest advice comes first: a synonym, a typing error, a key, an option of another command, a similar name.
    """
    context = error.ctx
    params = [] if context is None else context.command.params
    options = {name: param.opts for param in params if isinstance(param, click.Option) for name in param.opts}
    name, long_forms = error.option_name.lstrip("-"), [option for option in options if option.startswith("--")]
    close, synonym = close_to(f"--{name}", long_forms, cutoff=0.7), OPTIONS.get(name)
    others = [] if context is None else _commands_with(error.option_name, context)
    if synonym in options:
        advice = f"Did you mean {min(options[synonym], key=len)!r}?"
    elif close_to(f"--{name}", close, cutoff=0.9):
        advice = f"Did you mean {close[0]!r}?"
    elif "--set" in options and (keys := _keys(name, bool(others))):
        alternatives = f", or {' or '.join(keys[1:])}" if keys[1:] else ""
        advice = f"A key of the scenario is set by --set {keys[0]}=VALUE{alternatives}."
    elif others and context is not None and isinstance(context.command, click.Group):
        command = next((word for word in words if word in context.command.commands), others[0])
        advice = f"Options follow the command: desim {command} ... {error.option_name}"
    elif others:
        advice = f"It is an option of {', '.join(others)}."
    else:
        advice = f"Did you mean {close[0]!r}?" if close else f"There are {', '.join(long_forms)}."
    return click.NoSuchOption(error.option_name, f"No such option {error.option_name!r}. {advice}", ctx=context)


def _commands_with(option: str, context: click.Context) -> list[str]:
    """Return the names of the other commands that have an option, in the order of the help."""
    group = context.find_root().command
    if not isinstance(group, click.Group):
        return []
    others = [command for command in group.commands.values() if command is not context.command]
    return [str(command.name) for command in others if any(option in param.opts for param in command.params)]


def _keys(name: str, is_option_elsewhere: bool) -> list[str]:
    """Return the outermost keys of scenarios, at most three, whose last part is a name without hyphens.

    If another command has an option of this name, the user more likely means that option than a key of a property or
    sweep; these keys are left out.
    """
    from desim.config.key_index import homes_of
    from desim.config.key_suggestions import WORDS_FOR_KEYS
    from desim.scenario.scenario import Scenario

    word = name.replace("-", "_")
    synonyms = dict.fromkeys([WORDS_FOR_KEYS.get(word, word), word])
    # `homes_of` returns keys of a similar name if there is none of the name itself.
    matches = [key for last in synonyms for key in homes_of(last, Scenario) if key.place[-1] == last]
    keys = list(dict.fromkeys(key.dotted for key in matches))[:3]
    return [key for key in keys if not (is_option_elsewhere and key.startswith(("properties.", "sweep.")))]


def _about_value(message: str, param: click.Parameter) -> str:
    """Return the message about a value that an option does not take, with what it takes.

    The message of click is "'x' is not a valid float.", "'x' is not in the range ..." or "'x' is not one of ...".
    """
    value, _, wrong = message.partition(" is not ")
    from desim.config.number_texts import number_instead_of

    if (
        param.metavar == "SECONDS"
        and wrong.startswith("a valid float")
        and (reason := number_instead_of(value.strip("'"), {"s"}))
    ):
        return f"{value} {reason.partition(' instead of')[0]}."  # without "instead of the text 'x'"
    if wrong.startswith(("a valid int", "a valid float", "in the range")):
        number = "a whole number" if isinstance(param.type, click.types.IntParamType) else "a number"
        return "; ".join(filter(None, [f"{value} should be {number}{_limits(param.type)}", _purpose(param)])) + "."
    if isinstance(param.type, click.Choice):
        value = message.partition("' is not")[0].lstrip("'")
        close = close_to(value, [str(choice) for choice in param.type.choices])
        return f"{message} Did you mean {close[0]!r}?" if close else message
    return message


def _limits(number_type: click.ParamType[Any]) -> str:
    """Return the range of a type of numbers, " from 1 to 50" for instance; "" without a range."""
    low, high = getattr(number_type, "min", None), getattr(number_type, "max", None)
    if low is None and high is None:
        return ""
    if high is None:
        return f" above {low:,g}" if getattr(number_type, "min_open", False) else f" of at least {low:,}"
    return f" from {low:,} to {high:,}"


def options_given(names: Collection[str]) -> dict[str, str]:
    """Return the parameters with these names that the user has typed, each as typed: {"runs": "-n"}, for instance."""
    context = click.get_current_context()
    parameters = [parameter.name for parameter in context.command.params]
    typed = (name for name in names if context.get_parameter_source(name) is ParameterSource.COMMANDLINE)
    return {name: spelled(name) for name in typed if name in parameters}


def spelled(name: str) -> str:
    """Return the option of a parameter as the user has typed it, "-n" for instance; else its long form."""
    context = click.get_current_context()
    option = next(parameter for parameter in context.command.params if parameter.name == name)
    for word in reversed(context.meta.get(WORDS, ())):
        for form in (*option.opts, *option.secondary_opts):
            is_short = not form.startswith("--")  # which a value may follow without a space, as in -n20
            if word.partition("=")[0] == form or (is_short and word.startswith(form)):
                return form
    return " or ".join((max(option.opts, key=len), *option.secondary_opts))


def metric_option() -> str:
    """Return the option of the current command that names a metric, as the user has typed it."""
    names = {parameter.name for parameter in click.get_current_context().command.params}
    return spelled(next(name for name in ("metric", "metrics", "y") if name in names))


def problem(error: ValueError, **parameters: str) -> str:
    """Return the message of an error, in which options of the current command replace the arguments of a function.

    An argument is the name of an `ArgumentError`, the place of a `Problem`, or a word between backticks.

    Args:
        error: the error.
        parameters: the parameter of the command for each argument of the function, where their names differ.
    """
    if isinstance(error, NoMetricError):
        return f"{metric_option()} {error.name}: {error}"
    names = {str(parameter.name): str(parameter.name) for parameter in click.get_current_context().command.params}
    names |= parameters

    def typed(name: str) -> str | None:
        return spelled(names[name]) if name in names else None

    text = str(error)
    if isinstance(error, ArgumentError):
        text = str(ArgumentError(typed(error.name) or error.name, error.reason))
    elif isinstance(error, KeyedError):
        text = "\n".join(str(entry._replace(where=typed(entry.where) or entry.where)) for entry in error.problems)
    return ARGUMENT.sub(lambda match: typed(match[1]) or match[0], text)
