"""Words of other programs, of papers and of other languages, each with what desim says to write instead."""

import re

import pytest

import desim
from desim import Scenario, Team, run
from desim.config.extras import missing
from desim.config.key_suggestions import suggestion
from tests.command import refused

SHORT = Scenario(horizon=0.01, team=Team(count=1))

KEYS = {
    "start": ["at"],
    "latency": ["delay"],
    "cv": ["deviation", "sigma", "std", "stddev"],
    "min_timeout": ["floor"],
    "belief_timeout": ["forget_after"],
    "static": ["frozen"],
    "flees_from": ["heeds"],
    "holding_time": ["hold"],
    "track_timeout": ["lost_after"],
    "captures_to_end": ["needed"],
    "schedule": ["of"],
    "normally": ["otherwise"],
    "loss": ["packet_loss", "packetloss", "packet-loss"],
    "relay": ["pass_on"],
    "winner_timeout": ["patience"],
    "node": ["pursuer", "robot"],
    "participation": ["q"],
    "reception": ["reach"],
    "reaction_delay": ["reaction"],
    "sensing_range": ["sight"],
    "dissemination": ["spread"],
    "reheat_on": ["surprises"],
    "during_handover": ["then"],
    "synchronous": ["together"],
    "end": ["until"],
    "on_lost": ["when_lost"],
    # kinds
    "cbaa": ["auction", "consensus", "Auction"],
    "cbba": ["auction", "consensus"],
    "shifted_exponential": ["exponential"],
    "constant": ["fixed"],
    "lognormal": ["gauss", "gaussian", "normal"],
    "gilbert_elliott": ["gilbert"],
    "argmin": ["greedy"],
    "local_min": ["greedy"],
    "centralised": ["hungarian"],
    "bernoulli": ["iid", "random"],
    "uniform": ["random"],
    "sap": ["spatial_adaptive_play", "Spatial Adaptive Play"],
}
"""Keys and kinds, and the words that may mean them."""


@pytest.mark.parametrize(("key", "word"), [(key, word) for key, words in KEYS.items() for word in words])
def test_a_key_or_a_kind_is_suggested_for_a_word_that_may_mean_it(key, word):
    """Among names that are not similar, and only if the name is allowed there."""
    assert suggestion(word, ["zzzz", key, "yyyy"]) == f", did you mean {key!r}?"
    assert suggestion(word, ["zzzz", "yyyy"]) == ""


ARGUMENTS = {
    # a call, and the argument that it suggests for each of some names
    "sweep(SHORT, {}=1)": {
        "executor": ["cores", "jobs", "n_jobs", "processes", "workers", "Workers"],
        "reps": ["n", "n_runs", "num_runs", "repeats", "repetitions", "runs"],
    },
    "find_violation(SHORT, 'x', {}=1)": {
        "jobs": ["cores", "n_jobs", "processes", "workers"],
        "runs": ["n", "n_runs", "num_runs", "repeats", "repetitions", "reps"],
    },
    "SteppedNetwork(2, {}=1)": {"links": ["latency", "loss", "network", "range"]},
    "sensitivity(SHORT, {}=1)": {"points": ["samples"]},
    "run(SHORT, {}=1)": {"seed": ["seeds"]},
    "plot(SHORT, {}=1)": {"begin": ["window"]},
    "SHORT.with_({}=1)": {"changes": ["overrides"]},
}


@pytest.mark.parametrize("call", ARGUMENTS)
def test_an_argument_is_suggested_for_its_name_in_other_packages(call):
    names = {"SHORT": SHORT} | {name: getattr(desim, name) for name in desim.__all__}
    for argument, words in ARGUMENTS[call].items():
        for word in words:
            with pytest.raises(TypeError, match=f"'{word}', did you mean '{argument}'") as refusal:
                eval(call.format(word), names)
            assert str(refusal.value).count("did you mean") == 1


OF_AGENTS = {
    "assign(action)": ["act", "chase", "set_action"],
    "now": ["clock", "time"],
    "sleep(duration)": ["delay", "timeout", "wait"],
    "mail()": ["get", "inbox", "messages", "receive", "recv"],
    "id": ["index", "number"],
    "position()": ["pos", "xy"],
    "position().real": ["x"],
    "position().imag": ["y"],
    "rng": ["random"],
    "evader()": ["target"],
    "speed": ["velocity"],
}


@pytest.mark.parametrize(("meant", "word"), [(meant, word) for meant, words in OF_AGENTS.items() for word in words])
def test_an_agent_says_what_it_has_for_the_names_of_others(meant, word):
    def protocol(me):
        yield getattr(me, word)

    with pytest.raises(AttributeError) as refusal:
        run(SHORT.with_({"protocol": protocol}))
    said = " ".join([str(refusal.value), *getattr(refusal.value, "__notes__", ())])
    assert re.search(rf"write me\.{re.escape(meant)}(?![\w(.])", said)


OPTIONS = {
    "-j": ["cores", "cpus", "parallel", "processes", "threads", "workers"],
    "-n": ["count", "n-runs", "num-runs", "repetitions", "reps", "seeds"],
    "-o": ["dir", "folder", "outdir", "output"],
}


def test_an_option_is_suggested_for_its_name_in_other_programs():
    for option, words in OPTIONS.items():
        for word in words:
            assert f"No such option '--{word}'. Did you mean '{option}'?" in refused("run", "f.toml", f"--{word}", 3)
    assert "No such option '--metric'. Did you mean '-y'?" in refused("compare", "a", "b", "--metric", "captured")
    assert "No such option '--y'. Did you mean '--metric'?" in refused("run", "f.toml", "--y", "captured")


COMMANDS = {
    "plot FILE --kind film": ["animate", "film", "gif", "movie", "video"],
    "new": ["create", "init"],
    "compare": ["diff"],
    "plot": ["draw"],
    "play": ["gui", "show", "web"],
    "--help": ["help"],
    "ls": ["list"],
    "run": ["simulate", "start"],
    "check": ["validate"],
    "--version": ["version"],
}


def test_a_command_is_suggested_for_its_name_in_other_programs():
    for command, words in COMMANDS.items():
        for word in words:
            assert f"No such command '{word}'. Did you mean 'desim {command}'?" in refused(word)


def test_a_scenario_file_or_a_script_in_place_of_a_command_is_told_how_to_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "relay").write_text("")
    for word in ("missing.toml", "relay", "./relay"):
        assert f"No such command '{word}'. To run a scenario file, type: desim run {word}" in refused(word)
    assert "No such command 'x.py'. A script is run by Python: python x.py" in refused("x.py")
    assert "desim run" not in refused("missing")


NEEDED = {
    "check": "needs FILE: a scenario file; `desim examples relay` writes relay.toml, for instance",
    "compare": "needs A: the folder of a sweep, which `desim sweep FILE -o DIR` writes",
    "crossover": "needs DIR: a folder with results, which `desim run`, `sweep` and others write with -o DIR",
    "crossover x": "needs KEY: a key of the grid, network.latency.value for instance",
    "export x": "needs TO: the file to write, runs.csv for instance; its suffix sets the format",
    "fates": "needs LOG: a CSV or Parquet file with the columns t, src, dst and size",
    "merge": "needs STORES...: the folders of the sweeps to merge",
    "new": "needs one of scenario, protocol, latency, evader, metric",
    "new protocol": "needs NAME: the name of what is written, my_rule for instance",
    "plot": "needs DIR|FILE: a folder with results, which `desim run`, `sweep` and others write with -o DIR, or",
    "run": "needs a FILE, or --from RUN.JSON; `desim examples relay` writes relay.toml, which `desim run",
    "status": "needs FOLDER: the folder of a sweep, which `desim sweep FILE -o DIR` writes",
}


@pytest.mark.parametrize("words", NEEDED)
def test_a_command_says_what_it_needs(words):
    assert f"Error: {NEEDED[words]}" in refused(*words.split())


EXTRAS = {
    "plot": ["PIL", "jinja2", "matplotlib"],
    "notebook": ["anywidget", "traitlets"],
    "cluster": ["dask", "distributed"],
    "rl": ["greenlet", "gymnasium", "pettingzoo"],
    "film": ["imageio_ffmpeg"],
    "mcap": ["mcap"],
    "live": ["msgspec"],
    "frame": ["pandas"],
    "parquet": ["pyarrow"],
}


def test_a_package_that_is_not_installed_is_told_with_its_extra():
    for extra, packages in EXTRAS.items():
        for package in packages:
            assert f"desim[{extra}]" in missing(package), package


TOML = {
    "false": ["False"],
    "true": ["True"],
    "inf": ["Infinity", "infinity", "math.inf", "np.inf"],
    "nan": ["NaN"],
}


def test_a_constant_of_another_language_is_told_as_toml_writes_it(tmp_path):
    for meant, words in TOML.items():
        for word in words:
            (tmp_path / "f.toml").write_text(f"horizon = {word}\n")
            said = refused("check", tmp_path / "f.toml")
            assert f"f.toml:1: not TOML: horizon should be {meant} instead of {word}" in said


UNITS = {
    # what is meant by six of each unit, by the unit of the key
    "horizon": {"s": "6", "sec": "6", "ms": "0.006", "us": "6e-06", "ns": "6e-09", "min": "360", "MS": "0.006"},
    "capture.radius": {"m": "6", "km": "6000", "cm": "0.06", "mm": "0.006"},
    "network.loss.p": {"%": "0.06"},
}
FORMS = {"horizon": "a number, in s", "capture.radius": "a number, in m", "network.loss.p": "a number from 0 to 1"}


@pytest.mark.parametrize("key", UNITS)
def test_a_number_with_a_unit_is_told_in_that_of_its_key(key):
    for unit in {unit for units in UNITS.values() for unit in units} | {"h", "mi"}:
        for text in (f"6{unit}", f"6 {unit}", f"6.0 {unit}"):
            with pytest.raises(ValueError, match=re.escape(key)) as refusal:
                SHORT.with_({key: text})
            said = (
                f"should be {FORMS[key]}: {UNITS[key][unit]} instead of the text {text!r}"
                if unit in UNITS[key]
                else f"should be a number without a unit (got {text!r})"
            )
            assert f"{key}: {said}" in str(refusal.value)


ELSEWHERE = {
    "belief_timeout": ("forget_after", "announce.belief_timeout"),
    "dissemination": ("spread", "announce.dissemination"),
    "flees_from": ("heeds", "evader.strategy.flees_from"),
    "holding_time": ("hold", "protocol.schedule.holding_time"),
    "loss": ("packet_loss", "network.loss"),
    "normally": ("otherwise", "evader.strategy.normally"),
    "on_lost": ("when_lost", "sensing.on_lost"),
    "participation": ("q", "protocol.schedule.participation"),
    "reaction_delay": ("reaction", "evader.reaction_delay"),
    "reception": ("reach", "network.reception"),
    "reheat_on": ("surprises", "protocol.tau.reheat_on"),
    "schedule": ("of", "protocol.schedule"),
    "sensing_range": ("sight", "evader.sensing_range"),
    "static": ("frozen", "motion.static"),
    "track_timeout": ("lost_after", "sensing.track_timeout"),
    "winner_timeout": ("patience", "protocol.winner_timeout"),
}


@pytest.mark.parametrize("key", ELSEWHERE)
def test_a_key_is_suggested_in_its_table_for_a_word_that_may_mean_it(key):
    """Capital letters and hyphens make no difference."""
    plain, place = ELSEWHERE[key]
    for word in (plain, plain.title().replace("_", "-")):
        with pytest.raises(ValueError, match=rf"^Scenario: {word}: unknown key, did you mean {re.escape(place)}\?;"):
            Scenario(**{word: 1})


def test_a_key_with_a_capital_letter_is_suggested_once():
    with pytest.raises(ValueError, match=r"did you mean 'horizon'\?;"):
        Scenario(Horizon=1)
