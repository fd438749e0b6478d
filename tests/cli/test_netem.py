"""`desim netem`: commands of tc from a scenario, and a scenario from commands of tc."""

import tomllib
from contextlib import nullcontext

import pytest

from desim.kernel.models.links import Links
from desim.kernel.models.netem_tables import read_table
from desim.live.namespaces import NamespaceError, _netem_commands
from desim.scenario.toml import load
from scenarios.studies.study import SCENARIOS
from tests.command import accepted, desim, refused

EXAMPLE = SCENARIOS / "netem.toml"
MEASURED = """\
network.latency = { kind = "empirical", values = [0.01, 0.02, 0.05] }
network.loss = { kind = "gilbert_elliott", advance = "time" }
fault = [{ kind = "crash", node = 0, start = 1.0 }]
team.count = 2
"""


def test_the_commands_of_the_example_give_its_network_when_read_back(tmp_path):
    """From a file, and from the command line, where the first command is the whole network."""
    printed = accepted("netem", EXAMPLE, "--dev", "wlan0")
    assert printed.stderr == ""
    (tmp_path / "links.sh").write_text(printed.stdout)
    table = tomllib.loads(accepted("netem", "--from", tmp_path / "links.sh").stdout)
    assert Links.model_validate(table["network"]) == load(EXAMPLE).network
    first = next(line for line in printed.stdout.splitlines() if line.startswith("tc qdisc add dev wlan0 root netem "))
    alone = tomllib.loads(accepted("netem", "--parse", first).stdout)
    assert alone["network"] == {key: each for key, each in table["network"].items() if key != "link"}


def test_tables_are_written_and_read_and_what_netem_lacks_is_warned_of(tmp_path):
    file, folder = tmp_path / "measured.toml", tmp_path / "tables"
    file.write_text(MEASURED)
    bare = accepted("netem", file)
    assert f"warning: {file}: tc needs the tables desim-empirical: write them with --table DIR" in bare.stderr
    assert f"warning: {file}: network.loss: netem has no such model" in bare.stderr
    assert f"warning: {file}: fault: netem has no faults" in bare.stderr
    written = accepted("netem", file, "--table", folder)
    assert written.stdout == bare.stdout
    assert f"wrote {folder / 'desim-empirical.dist'}\n" in written.stderr
    assert f"TC_LIB_DIR={folder}" in written.stderr
    command = written.stdout.splitlines()[-1]
    latency = tomllib.loads(accepted("netem", "--parse", command, "--table", folder).stdout)["network"]["latency"]
    assert latency["file"] == str(folder / "desim-empirical.dist")
    scenario = tmp_path / "back.toml"
    scenario.write_text(
        "network.latency = { kind = 'netem', delay = 0.1, jitter = 0.1, file = 'tables/desim-empirical.dist' }"
    )
    assert load(scenario).network.latency.table == read_table(folder / "desim-empirical.dist")


def test_walls_that_weaken_radio_are_warned_of_and_others_are_not(tmp_path):
    file = tmp_path / "walls.toml"
    for blocks, is_warned in (("radio", True), ("sight", False)):
        file.write_text(f'team.count = 2\n[[wall]]\nline = [[6, -9], [6, 9]]\nblocks = ["{blocks}"]\n')
        assert ("wall: netem does not know positions" in desim("netem", file).stderr) is is_warned
        with pytest.raises(NamespaceError, match="wall: netem") if is_warned else nullcontext():
            _netem_commands(load(file))


def test_commands_without_effect_in_desim_are_warned_of():
    read = accepted("netem", "--parse", "tc qdisc add dev eth0 root netem limit 9")
    assert read.stdout == "[network]\n"
    assert read.stderr.startswith("warning: --parse:1:1: limit has no effect without a rate")


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (
            ["--parse", "tc qdisc add dev eth0 root netem los 1%"],
            "--parse:1:34: 'los' is not allowed here; allowed: delay,",
        ),
        (["--from", "none.sh"], "none.sh cannot be read: No such file"),
        (["--parse", "tc qdisc add dev a root netem rate 1bit -99"], "--parse:1:1: medium: should be greater than or"),
        (["none.toml"], "none.toml: cannot be read: No such file"),
        (["--parse", "tc qdisc del dev eth0 root"], "--parse: no command adds netem, so nothing is read"),
        (["--parse", " "], "--parse: no command adds netem, so nothing is read"),
        ([EXAMPLE, "--dev", "$(id)"], f"{EXAMPLE}: --dev: the name has at most 15 letters"),
        ([EXAMPLE, "--dev", "a;b"], f"{EXAMPLE}: --dev: the name has at most 15 letters"),
        ([EXAMPLE, "--dev", "a b"], f"{EXAMPLE}: --dev: the name has at most 15 letters"),
        ([EXAMPLE, "--dev", "-x"], f"{EXAMPLE}: --dev: the name has at most 15 letters"),
        ([EXAMPLE, "--dev", "enp0s31f6abc"], f"{EXAMPLE}: --dev: the name has at most 15 letters"),
    ],
)
def test_wrong_input_is_refused(words, why):
    assert refused("netem", *words).startswith(why)


def test_a_file_that_is_not_text_and_a_table_that_cannot_be_written_are_refused(tmp_path):
    (tmp_path / "binary").write_bytes(b"\xff\xff")
    assert refused("netem", "--from", tmp_path / "binary").startswith(
        f"{tmp_path / 'binary'} cannot be read: it is not text in UTF-8"
    )
    (tmp_path / "measured.toml").write_text(MEASURED)
    result = desim("netem", tmp_path / "measured.toml", "--table", tmp_path / "binary")
    assert result.exit_code == 2
    assert "desim-empirical.dist: cannot be written" in result.stderr


def test_a_file_of_commands_may_have_a_byte_order_mark_and_lines_of_windows(tmp_path):
    command = "tc qdisc add dev eth0 root netem delay 100ms"
    (tmp_path / "links.sh").write_bytes(f"\ufeff{command} \\\r\n  loss 10%\r\n".encode())
    read, expected = (
        accepted("netem", "--from", tmp_path / "links.sh"),
        accepted("netem", "--parse", f"{command} loss 10%"),
    )
    assert read.stdout == expected.stdout


@pytest.mark.parametrize("words", [[], [EXAMPLE, "--parse", "tc"], ["--from", "a", "--parse", "tc"]])
def test_exactly_one_thing_is_read(words):
    result = desim("netem", *words)
    assert result.exit_code == 2
    assert "needs one of FILE, --parse COMMAND and --from FILE" in result.stderr
