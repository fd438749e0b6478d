"""The messages about wrong words on the command line: what to type instead, for all commands and studies."""

import re
from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType

import click
from click.core import ParameterSource

from desim.config.errors import NoMetricError
from desim.config.suggestion import close_to

OPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "cores": "--jobs",
        "count": "--runs",
        "cpus": "--jobs",
        "dir": "--out",
        "folder": "--out",
        "n-runs": "--runs",
        "num-runs": "--runs",
        "outdir": "--out",
        "output": "--out",
        "parallel": "--jobs",
        "processes": "--jobs",
        "repetitions": "--runs",
        "reps": "--runs",
        "seeds": "--runs",
        "threads": "--jobs",
        "workers": "--jobs",
    }
)
"""Options that other programs have, without their hyphens, and the option of desim."""
COMMANDS: Mapping[str, str] = MappingProxyType(
    {
        "animate": "plot FILE --kind film",
        "create": "new",
        "diff": "compare",
        "draw": "plot",
        "film": "plot FILE --kind film",
        "gif": "plot FILE --kind film",
        "gui": "play",
        "help": "--help",
        "init": "new",
        "list": "ls",
        "movie": "plot FILE --kind film",
        "show": "play",
        "simulate": "run",
        "start": "run",
        "validate": "check",
        "video": "plot FILE --kind film",
        "web": "play",
    }
)
"""Names that users try, each with the command that they mean."""
WORDS = "desim.words"
"""The key of the words of the command line in the context of a command."""
ARGUMENT = re.compile(r"\A(?P<first>\w+)|`(?P<quoted>\w+)`")
"""Matches an argument of a function in the message of an error."""


def no_command(word: str) -> str | None:
    """Return the message for a word in place of a command; None if nothing is known about the word."""
    if word in COMMANDS:
        return f"No such command {word!r}. Did you mean 'desim {COMMANDS[word]}'?"
    if word.endswith(".py"):
        return f"No such command {word!r}. A script is run by Python: python {word}"
    if word.endswith(".toml") or Path(word).is_file():
        return f"No such command {word!r}. To run a scenario file, type: desim run {word}"
    return None


def advised(error: click.UsageError) -> click.UsageError:
    """Return an error whose message says what to type instead; the error itself if that is not known."""
    if isinstance(error, click.NoSuchOption):
        return _about_option(error)
    if type(error) is click.BadParameter and error.param is not None:
        message = _about_value(error.message, error.param)
        return click.BadParameter(message, error.ctx, error.param, error.param_hint)
    return error


def _about_option(error: click.NoSuchOption) -> click.NoSuchOption:
    """Return the error with the option, or the key of a scenario, that a wrong option means."""
    params = [] if error.ctx is None else error.ctx.command.params
    options = {name: param.opts for param in params if isinstance(param, click.Option) for name in param.opts}
    name = error.option_name.lstrip("-")
    close = close_to(f"--{name}", [option for option in options if option.startswith("--")], cutoff=0.7)
    meant = OPTIONS.get(name)
    possible = ([min(options[meant], key=len)] if meant in options else []) or close
    advice = f" Did you mean {possible[0]!r}?" if possible else ""
    if "--set" in options and meant is None and (keys := _keys(name)):
        others = f", or {' or '.join(keys[1:])}" if keys[1:] else ""
        advice = f" A key of the scenario is set by --set {keys[0]}=VALUE{others}."
    return click.NoSuchOption(error.option_name, f"No such option {error.option_name!r}.{advice}", ctx=error.ctx)


def _keys(option: str) -> list[str]:
    """Return the outermost keys of scenarios, at most three, whose last part is the name of an option."""
    from desim.config.key_errors import RENAMED
    from desim.config.key_index import homes_of
    from desim.scenario.scenario import Scenario

    word = option.replace("-", "_")
    names = dict.fromkeys([RENAMED.get(word, word), word])
    homes = [key for name in names for key in homes_of(name, Scenario) if key.place[-1] == name]
    return list(dict.fromkeys(key.dotted for key in homes))[:3]


def _about_value(message: str, param: click.Parameter) -> str:
    """Return the message about a value that an option does not take, with what it takes."""
    if isinstance(param.type, click.IntRange) and message.endswith("is not a valid integer range."):
        low, high = param.type.min, param.type.max
        limits = "" if low is None else f" of at least {low}" if high is None else f" from {low} to {high:,}"
        value = message.removesuffix(" is not a valid integer range.")
        purpose = (getattr(param, "help", None) or "").partition(". ")[0].rstrip(".")
        return "; ".join(filter(None, [f"{value} should be a whole number{limits}", purpose])) + "."
    if isinstance(param.type, click.Choice):
        value = message.partition("' is not")[0].lstrip("'")
        close = close_to(value, [str(choice) for choice in param.type.choices])
        return f"{message} Did you mean {close[0]!r}?" if close else message
    return message


def options_given(names: Collection[str]) -> dict[str, str]:
    """Return those of some parameters that the command line has, and how it writes each, such as {"runs": "-n"}."""
    context = click.get_current_context()
    there = [parameter.name for parameter in context.command.params]
    typed = (name for name in names if context.get_parameter_source(name) is ParameterSource.COMMANDLINE)
    return {name: spelled(name) for name in typed if name in there}


def spelled(name: str) -> str:
    """Return an option of the current command as the command line writes it, "-n" for instance, or its long form.

    Args:
        name: the name of the parameter.
    """
    context = click.get_current_context()
    option = next(parameter for parameter in context.command.params if parameter.name == name)
    for word in reversed(context.meta.get(WORDS, ())):
        for form in (*option.opts, *option.secondary_opts):
            if word.partition("=")[0] == form or (word.startswith(form) and not form.startswith("--")):
                return form
    return " or ".join((max(option.opts, key=len), *option.secondary_opts))


def as_typed(message: str, **parameters: str) -> str:
    """Return the message of an error with options of the current command in place of the arguments that it names.

    An argument is named by the first word of a message, or between backticks.

    Args:
        message: the message.
        parameters: the parameters of the command by argument where the names differ.
    """
    names = {parameter.name: str(parameter.name) for parameter in click.get_current_context().command.params}
    names |= parameters

    def option(match: re.Match[str]) -> str:
        name = match["first"] or match["quoted"]
        return spelled(names[name]) if name in names else match[0]

    return ARGUMENT.sub(option, message)


def metric_option() -> str:
    """Return the option of the current command that names a metric, as the command line writes it."""
    names = {parameter.name for parameter in click.get_current_context().command.params}
    return spelled(next(name for name in ("metric", "metrics", "y") if name in names))


def problem(error: ValueError, **parameters: str) -> str:
    """Return the message of an error with the options of the command; see `as_typed`."""
    if isinstance(error, NoMetricError):
        return f"{metric_option()} {error.name}: {error}"
    return as_typed(str(error), **parameters)
