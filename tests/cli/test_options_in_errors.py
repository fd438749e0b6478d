"""Errors about the value of an option name the option as the command line writes it."""

from inspect import signature

import click
import pytest
from click.testing import CliRunner

import desim
from desim import Scenario, sweep
from desim.cli import main
from desim.cli.program import Program
from desim.cli.usage import check_hyphens, options_given, problem, spelled
from desim.config.errors import ArgumentError, KeyedError, Problem
from desim.study.results.result import SweepResult
from tests.command import refused


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swept")
    scenario = Scenario(horizon=0.01, team={"count": 2}, record={"trajectory": 0})
    sweep(scenario, {"team.count": [2, 3], "capture.radius": [0.1, 0.2]}, 2, store=folder / "sweep.sqlite")
    return folder


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("plot", "DIR", "-y", "nope"), "-y nope: there is no numeric metric 'nope'"),
        (("plot", "DIR", "--y=nope"), "--y nope: there is no numeric metric 'nope'"),
        (("plot", "DIR", "-x", "nope"), "-x nope: the grid has no key nope"),
        (("plot", "DIR", "--by", "nope"), "--by nope: the grid has no key nope"),
        (("plot", "DIR", "--against", "team.count=7"), "--against team.count=7: team.count does not take the value 7"),
        (("plot", "DIR", "--size", "large"), "--size should be a width"),
        (("plot", "DIR", "--size", "500cm"), "--size should be from"),
        (("report", "DIR", "--against", "team.count=7"), "--against team.count=7: team.count does not take the value"),
        (("compare", "DIR", "DIR", "-y", "nope"), "-y nope: there is no numeric metric"),
        (("crossover", "DIR", "team.count", "--over", "10%", "-y", "nope"), "-y nope: there is no numeric metric"),
        (
            ("crossover", "DIR", "team.count", "--over", "10%", "--baseline", 7),
            "--baseline 7: team.count does not take the value 7",
        ),
        (
            ("crossover", "DIR", "team.count", "--over", "10%", "--where", "capture.radius=7"),
            "--where capture.radius=7: capture.radius does not take the value 7",
        ),
        (("export", "DIR", "x.md", "--metric", "nope"), "--metric nope: there is no numeric metric"),
        (("export", "DIR", "x.md", "--without", "nope"), "--without: no table has a column nope"),
    ],
)
def test_an_error_names_the_option(swept, words, why, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert why in refused(*(swept if word == "DIR" else word for word in words))


@click.command(cls=Program)
@click.option("-n", "--runs", default=1)
@click.option("--first", default=1)
@click.option("--maximise/--minimise", default=None)
def command(**_):
    for name in ("runs", "first", "maximise"):
        click.echo(spelled(name))
    click.echo(problem(ArgumentError("most", "should be `first`, of `others`"), most="runs"))
    click.echo(options_given(("runs", "maximise", "others")))


@click.command(cls=Program)
@click.option("--seed", default=1)
@click.option("--grid", default="")
def failing(**_):
    click.echo(problem(ValueError("seed 1: the run fails without any loss")))
    click.echo(problem(KeyedError(Problem("should be a number", "team.count", "vary")), vary="grid"))


def test_only_the_fields_of_an_error_name_an_argument():
    lines = CliRunner().invoke(failing, [], catch_exceptions=False).stdout.splitlines()
    assert lines == ["seed 1: the run fails without any loss", "--grid: team.count: should be a number"]


@pytest.mark.parametrize(
    ("words", "forms"),
    [
        ([], ["--runs", "--first", "--maximise or --minimise", "--runs should be --first, of `others`", "{}"]),
        (
            ["-n", "3"],
            ["-n", "--first", "--maximise or --minimise", "-n should be --first, of `others`", "{'runs': '-n'}"],
        ),
        (["-n3", "--minimise"], ["-n", "--first", "--minimise", "-n should be --first, of `others`", "{"]),
        (["-n", "3", "--runs=4"], ["--runs", "--first", "--maximise or --minimise", "--runs should be --first", "{"]),
    ],
)
def test_an_option_is_spelled_as_it_was_typed_last(words, forms):
    lines = CliRunner().invoke(command, words, catch_exceptions=False).stdout.splitlines()
    assert [line[: len(form)] for line, form in zip(lines, forms, strict=True)] == forms


def commands(group=main, above=()):
    """Yield every command with the words that call it."""
    for name, command in group.commands.items():
        yield (*above, name), command
        if isinstance(command, click.Group):
            yield from commands(command, (*above, name))


def test_each_option_has_its_short_form_first_as_its_errors_name_it():
    several = {
        (words, tuple(param.opts)) for words, command in commands() for param in command.params if param.opts[1:]
    }
    assert len(several) > 50
    assert [each for each in several if not 2 == len(each[1][0]) < len(each[1][1])] == []


OF_PICTURES = {
    "-y": ("active_time", {"means", "phase", "scatter", "contour"}),
    "-x": ("team.count", {"means"}),
    "--by": ("capture.radius", {"means"}),
    "--against": ("team.count=2", {"means"}),
    "--label": ("2=two", {"means"}),
    "--xlabel": ("size", {"means", "phase"}),
    "--ylabel": ("time", {"means", "phase"}),
    "--from": ("0.001", {"spacetime", "film"}),
    "--to": ("0.002", {"spacetime", "film"}),
    "--pursuers": ("0", {"spacetime"}),
    "--speed": ("2", {"film"}),
    "--fps": ("10", {"film"}),
    "--size": ("8cm", {"trajectory", "spacetime", "film", "means", "phase", "scatter", "contour"}),
}
"""The options of `desim plot`, each with a value and the kinds of pictures that take it."""
KINDS = set().union(*(kinds for _, kinds in OF_PICTURES.values()), {"perfetto"})


@pytest.mark.parametrize("option", OF_PICTURES)
def test_an_option_of_other_kinds_of_pictures_is_refused_with_these(swept, option):
    value, kinds = OF_PICTURES[option]
    for kind in KINDS - kinds:
        source = swept if kind in {"means", "phase", "scatter", "contour"} else "f.toml"
        told = refused("plot", source, "--kind", kind, option, value)
        of = set(told.partition(f"{option} is an option of ")[2].partition(";")[0].split(" and "))
        assert of == kinds
        assert f"this picture is of the kind {kind}" in told


@pytest.mark.parametrize("option", [name for name, (_, kinds) in OF_PICTURES.items() if "means" in kinds])
def test_an_option_of_means_asks_for_means(swept, option, monkeypatch):
    """The usual picture of a design is a scatter plot; it takes a metric and a size, too."""

    def plot(result, **options):
        raise ValueError(f"drawn: {options.pop('kind')}")

    monkeypatch.setattr(SweepResult, "usual_kind", "scatter")
    monkeypatch.setattr(SweepResult, "plot", plot)
    value, kinds = OF_PICTURES[option]
    drawn = "scatter" if "scatter" in kinds else "means"
    assert refused("plot", swept, option, value) == f"drawn: {drawn}\n"


@pytest.mark.parametrize("name", main.commands)
def test_a_long_option_with_one_hyphen_is_none_of_short_ones(name):
    """-seed would be -s with the value "eed"."""
    command = main.commands[name]
    names = {option for param in command.params for option in param.opts if option.startswith("--") and len(option) > 3}
    context = click.Context(main)
    for option in {*names, "--help"}:
        for word in (option[1:], f"{option[1:]}=1"):
            with pytest.raises(click.UsageError, match=f"Did you mean '{option}'"):
                check_hyphens([name, word], context)
    check_hyphens([name, *names, "-n", "--", "-help"], context)


def test_an_option_of_another_command_is_no_key_of_a_sweep(tmp_path):
    """`--set sweep.grid=...` of a run has no effect."""
    (tmp_path / "f.toml").write_text("horizon = 0.1\n")
    for command, option in (("run", "--grid"), ("run", "--design"), ("plot", "--grid"), ("live", "--design")):
        told = refused(command, tmp_path / "f.toml", option, "1")
        assert f"No such option '{option}'" in told
        assert "It is an option of" in told
        assert "sweep." not in told


def test_an_option_has_the_default_of_the_parameter_of_its_name():
    """A command and the function of its name, from which scripts call the same, do alike unless told otherwise."""
    compared = {}
    for name, command in main.commands.items():
        function = getattr(desim, {"break": "find_violation"}.get(name, name), None)
        parameters = signature(function).parameters if callable(function) else {}
        for option in command.params:
            if isinstance(option.default, str | int | float) and option.name in parameters:
                compared[f"{name} {option.name}"] = (option.default, parameters[option.name].default)
    assert compared.pop("break jobs") == (1, 0)  # a script has all cores
    assert len(compared) >= 9
    assert all(default == other for default, other in compared.values()), compared
