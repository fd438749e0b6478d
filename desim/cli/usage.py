"""The messages about wrong words on the command line: what to type instead, for all commands and studies."""

from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType

import click
from click.core import ParameterSource

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
    """Return those of some parameters that the command line has, and how it writes each, such as {"runs": "--runs"}."""
    context = click.get_current_context()
    options = {parameter.name: parameter.opts[-1] for parameter in context.command.params if parameter.name}
    return {name: options[name] for name in names if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
