"""Links as commands of tc, and back."""

import re
import shutil
import subprocess
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from desim.kernel.models.access import Csma
from desim.kernel.models.graphs import Edges, Link, Ring
from desim.kernel.models.latency import Constant, Empirical, Lognormal, Propagation, Uniform
from desim.kernel.models.latency_by_link import PerPair
from desim.kernel.models.links import Links, Processing
from desim.kernel.models.loss import Bernoulli, ByDistance, Correlated, FourState, GilbertElliott
from desim.kernel.models.medium import Bitrate, LoRa
from desim.kernel.models.netem import Netem
from desim.kernel.models.netem_tables import SCALE, table_text
from desim.kernel.tc.reader import read_script
from desim.kernel.tc.syntax import NOT_MODELLED, OPTIONS, TcError
from desim.kernel.tc.units import share_of, share_word, steps_of
from desim.kernel.tc.writer import script
from tests.command import JARGON

SIZE = 4


def milliseconds(least):
    return st.integers(least, 10_000).map(lambda number: number / 1000)


SHARES = st.integers(0, 1000).map(lambda number: number / 1000)
POSITIVE = st.integers(1, 1000).map(lambda number: number / 1000)
JITTERS = st.integers(1, 2000).map(lambda number: number / 1000)


def netems():
    """Return latencies that no simpler kind describes."""
    free = {"correlation": SHARES, "distribution": st.sampled_from(["normal", "pareto", "paretonormal"])}
    reordered = {"reorder": POSITIVE, "reorder_correlation": SHARES, "gap": st.integers(1, 9)}
    return st.one_of(
        st.builds(Netem, delay=milliseconds(1), jitter=JITTERS, **free),
        st.builds(Netem, delay=milliseconds(1), jitter=JITTERS, correlation=POSITIVE, **reordered),
        st.builds(Netem, delay=milliseconds(1), **reordered),
    )


def uniforms():
    """Return uniform latencies whose middle and half of the width are whole milliseconds."""
    return st.tuples(milliseconds(1), POSITIVE).map(
        lambda pair: (
            Uniform(low=max(round(pair[0] - pair[1], 3), 0.0), high=round(pair[0] + pair[1], 3))
            if pair[0] >= pair[1]
            else Uniform(low=0.0, high=2 * pair[1])
        )
    )


def four_states():
    pairs = st.tuples(POSITIVE, POSITIVE).map(lambda pair: tuple(round(each * 0.5, 4) for each in pair))
    return st.tuples(pairs, pairs, POSITIVE).map(
        lambda all_: FourState(p13=all_[0][0], p14=all_[0][1], p31=all_[1][0], p32=all_[1][1], p23=all_[2])
    )


def bursts():
    """Return the model of Gilbert & Elliott with bursts that are long enough for every share drawn here."""
    losses = {"loss_good": SHARES, "loss_bad": SHARES}
    return st.builds(
        GilbertElliott, share=st.integers(0, 900).map(lambda n: n / 1000), burst=st.integers(9, 50).map(float), **losses
    )


EVENTS = st.one_of(st.builds(Bernoulli, p=SHARES), st.builds(Correlated, p=POSITIVE, correlation=POSITIVE))
LATENCIES = st.one_of(st.builds(Constant, value=milliseconds(0)), uniforms(), netems())
LOSSES = st.one_of(EVENTS, bursts(), four_states())


@st.composite
def networks(draw):
    """Return links that commands of tc describe completely, in the form in which they are read."""
    latency, loss = draw(LATENCIES), draw(LOSSES)
    medium = draw(
        st.one_of(
            st.just(Links().medium),
            st.builds(
                Bitrate,
                bitrate=st.integers(1, 10**9).map(float),
                header=st.integers(0, 100),
                queue_limit=st.one_of(st.just(np.inf), st.integers(0, 1000).map(float)),
            ),
        )
    )

    def order(latency):
        overtakes = isinstance(latency, Constant) or (isinstance(latency, Netem) and latency.reorder)
        return "fifo" if isinstance(medium, Bitrate) and not overtakes else "overtaking"

    links = []
    for src, dst in draw(st.lists(st.sampled_from([(0, 1), (1, 2), (3, 0)]), unique=True)):
        own = {"latency": draw(LATENCIES), "loss": draw(LOSSES)}
        own["order"] = order(own["latency"])
        usual = {"latency": latency, "loss": loss, "order": order(latency)}
        if own := {key: each for key, each in own.items() if each != usual[key]}:
            links.append(Link(src=src, dst=dst, both_ways=draw(st.booleans()), **own))
    return Links(
        latency=latency, loss=loss, order=order(latency), medium=medium, duplicate=draw(EVENTS), link=tuple(links)
    )


@pytest.mark.slow
@example(Links())
@given(networks())
def test_the_commands_of_a_scenario_give_the_same_scenario_when_read_back(links):
    lines, _, missing = script(links, SIZE)
    assert {key for key, _ in missing} <= {"network.medium.queue_limit"}
    network, ignored = read_script("\n".join(lines))
    assert Links.model_validate(network) == links
    assert not ignored


MEASURED = Links(
    latency=Lognormal(), loss=Bernoulli(p=0.1), link=(Link(src=0, dst=1, latency=Empirical(values=(0.1, 0.3))),)
)


def test_a_latency_with_quantiles_becomes_a_table_and_the_commands_read_back_are_the_same(tmp_path):
    """Read back, the latency is of the kind `netem`, and its commands have the same numbers."""
    lines, tables, missing = script(MEASURED, SIZE)
    assert list(tables) == ["desim-lognormal", "desim-empirical"]
    assert not missing
    for name, table in tables.items():
        (tmp_path / f"{name}.dist").write_text(table_text(table, name))
    links = Links.model_validate(read_script("\n".join(lines), folder=tmp_path).network)
    assert links.latency.table == tables["desim-lognormal"]
    u = np.array([0.001, 0.5, 0.999])
    assert links.latency.quantile(u) == pytest.approx(
        Lognormal().quantile(u), abs=links.latency.jitter / SCALE, rel=0.05
    )
    again = script(links, SIZE)
    assert list(again.tables.values()) == list(tables.values())
    assert [re.sub("desim-[a-z]+(-2)?", "X", line) for line in again.lines] == [
        re.sub("desim-[a-z]+", "X", line) for line in lines
    ]


TC = shutil.which("tc")
NO_DEVICE = "desim-no-device"


def refusal_of_tc(line, folder):
    """Return what tc says about a command for a device that does not exist, which it notices last."""
    words = line.replace("dev eth0", f"dev {NO_DEVICE}").split()
    done = subprocess.run(
        [TC, *words[1:]], capture_output=True, text=True, check=False, env={"TC_LIB_DIR": str(folder)}
    )
    return done.stderr


@pytest.mark.whole
@pytest.mark.skipif(TC is None, reason="tc is not installed")
@settings(max_examples=30, deadline=None)
@given(links=networks())
def test_the_commands_are_accepted_by_tc(tmp_path_factory, links):
    """The control is a word that tc does not know, and a table that is not there."""
    folder = tmp_path_factory.mktemp("tables")
    lines, tables, _ = script(links, SIZE)
    for name, table in tables.items():
        (folder / f"{name}.dist").write_text(table_text(table, name))
    for line in lines:
        if line.startswith("tc"):
            line = re.sub(r"dev \S+", "dev eth0", line)
            assert "Cannot find device" in refusal_of_tc(line, folder)
            assert "Cannot find device" not in refusal_of_tc(f"{line} lost 1%", folder)
    if tables:
        name = next(iter(tables))
        assert "No distribution data" in refusal_of_tc(
            f"tc qdisc add dev eth0 root netem delay 1ms 1ms distribution {name}", "/none"
        )


READ = {
    "": {},
    "delay 100ms": {"latency": {"kind": "constant", "value": 0.1}},
    "latency 0.1s 20msec": {"latency": {"kind": "uniform", "low": 0.08, "high": 0.12}},
    "delay 10ms 20ms": {"latency": {"kind": "netem", "delay": 0.01, "jitter": 0.02}},
    "delay 10ms 20ms 25%": {"latency": {"kind": "netem", "delay": 0.01, "jitter": 0.02, "correlation": 0.25}},
    "delay 10ms distribution normal": {"latency": {"kind": "constant", "value": 0.01}},
    "delay 10ms 1ms distribution uniform": {"latency": {"kind": "uniform", "low": 0.009, "high": 0.011}},
    "delay 10ms reorder 25% 50% gap 5": {
        "latency": {"kind": "netem", "delay": 0.01, "reorder": 0.25, "reorder_correlation": 0.5, "gap": 5}
    },
    "loss 1%": {"loss": {"kind": "bernoulli", "p": 0.01}},
    "drop random 0.3 25": {"loss": {"kind": "correlated", "p": 0.003, "correlation": 0.25}},
    "loss 0%": {},
    "loss gemodel 5% 20%": {"loss": {"kind": "gilbert_elliott", "share": 0.2, "burst": 5.0}},
    "loss gemodel 1%": {"loss": {"kind": "gilbert_elliott", "share": 0.01, "burst": 1.01010101}},
    "loss gemodel 5% 20% 70% 0.1%": {
        "loss": {"kind": "gilbert_elliott", "share": 0.2, "burst": 5.0, "loss_bad": 0.7, "loss_good": 0.001}
    },
    "loss state 5% 20%": {"loss": {"kind": "gilbert_elliott", "share": 0.2, "burst": 5.0}},
    "loss state 5% 20% 30%": {
        "loss": {"kind": "four_state", "p13": 0.05, "p31": 0.2, "p32": 0.3, "p23": 1.0, "p14": 0.0}
    },
    "duplicate 1%": {"duplicate": {"kind": "bernoulli", "p": 0.01}},
    "rate 1mbit": {"medium": {"kind": "bitrate", "bitrate": 1e6, "header": 42}},
    "rate 125kbps": {"medium": {"kind": "bitrate", "bitrate": 1e6, "header": 42}},
    "rate 1MBps -42 limit 11": {"medium": {"kind": "bitrate", "bitrate": 8e6, "header": 0, "queue_limit": 10.0}},
    "rate 1gbit delay 2ms 1ms": {
        "latency": {"kind": "uniform", "low": 0.001, "high": 0.003},
        "order": "fifo",
        "medium": {"kind": "bitrate", "bitrate": 1e9, "header": 42},
    },
}


@pytest.mark.parametrize("options", READ)
def test_options_are_read_as_the_simplest_models(options):
    """A latency without table and correlation is uniform, and the states 1 and 3 alone are Gilbert's model."""
    assert read_script(f"tc qdisc add dev eth0 root netem {options}") == (READ[options], [])


def test_a_file_of_commands_may_have_what_such_files_have():
    """Other comments, continued lines, deletion, other roots, and the same command for several devices."""
    text = """\
        # my links
        tc qdisc del dev eth0 root
        sudo TC_LIB_DIR=/tmp ip netns exec n1 tc qdisc replace dev eth0 parent 1:1 handle 10: netem \\
            delay 5ms \\
            loss 1%
        tc qdisc add dev eth1 root netem loss 1% delay 5ms limit 2000

        # link 2 -> 0
        tc qdisc change dev eth2 root netem loss 1%
        """
    network, (ignored,) = read_script(text, "links.sh")
    assert network == {
        "latency": {"kind": "constant", "value": 0.005},
        "loss": {"kind": "bernoulli", "p": 0.01},
        "link": [{"src": 2, "dst": 0, "latency": {"kind": "constant", "value": 0.0}}],
    }
    assert ignored.startswith("links.sh:6:9: limit has no effect without a rate")


REFUSED = {
    "dealy 100ms": (34, "'dealy' is not allowed here; allowed: delay, distribution, reorder, gap, loss, duplicate, ra"),
    "delay 100": (40, "'100' should be a time with its unit: s, ms, us or ns"),
    "delay 1ms 2ms 101%": (48, "'101%' should be a percentage in 0% .. 100%"),
    "delay": (34, "'delay' should be followed by a value"),
    "delay 1ms delay 2ms": (44, "'delay' is given twice"),
    "loss burst 1%": (39, "'burst' is not allowed here; allowed: a percentage, random, state, gemodel"),
    "loss gemodel 1% 0%": (1, "loss: a link that is lost for ever is not modelled"),
    "loss state 60% 10% 0% 50% 50%": (1, "loss: p13 + p14 should be at most 1 (got 1.1)"),
    "corrupt 1%": (34, "'corrupt' is not modelled: "),
    "delay 1ms slot 1ms": (44, "'slot' is not modelled: "),
    "rate 1mbit 20 100 5": (48, "'100' is not modelled: desim has no cells"),
    "rate fast": (39, "'fast' should be a bit rate of at least 1bit, in tbit, gbit"),
    "rate 1mbit -50": (1, "medium: should be greater than or equal to 0"),
    "gap 5": (38, "gap needs reorder"),
    "delay 1ms gap 0": (48, "'0' should be a whole number in 1 .. 4294967295"),
    "delay 0ms reorder 5%": (1, "latency: reorder, and a jitter with a table, need a delay > 0, as in tc"),
    "distribution normal": (47, "distribution needs delay"),
    "delay 1ms 1ms distribution ../own": (61, "'../own' should be the name of a table, without folder and suffix"),
    "delay 10s 5s": (1, "latency: should be less than or equal to 2.147483647"),
    "delay 9e10s": (40, "'9e10s' should be at most 1000000000s"),
    "delay 1ms 1ms distribution nromal": (1, "latency: nromal.dist cannot be read: No such file"),
}


@pytest.mark.parametrize("options", REFUSED)
def test_a_word_that_is_not_allowed_is_refused_with_line_column_and_what_is(options):
    column, why = REFUSED[options]
    with pytest.raises(TcError, match=rf"^links:2:{column}: {re.escape(why)}"):
        read_script(f"# links\ntc qdisc add dev eth0 root netem {options}", "links")


VOCABULARY = [
    *OPTIONS,
    *NOT_MODELLED,
    "tc",
    "qdisc",
    "add",
    "dev",
    "root",
    "netem",
    "sudo",
    "random",
    "state",
    "gemodel",
]
VOCABULARY += ["1ms", "1e99s", "1e999999s", "0", "25%", "1e-999999", "100%", "-42", "1e9gbit", "99999999999", "x=1"]
VOCABULARY += ["\\", "\n", "# link 0 -> 1"]


def refusal(text):
    """Return why a text is refused; "" if it is read."""
    try:
        Links.model_validate(read_script(text).network)
    except TcError as error:
        return str(error)
    return ""


@pytest.mark.slow
@given(st.lists(st.one_of(st.sampled_from(VOCABULARY), st.text(max_size=3))))
def test_any_text_is_read_or_refused(words):
    """Nothing else: no other exception, and no endless computation."""
    for text in (" ".join(words), " ".join(["tc qdisc add dev eth0 root netem", *words])):
        assert not JARGON.search(refusal(text))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (
            "ls -l",
            "tc:1:1: 'ls' is not allowed here; a command is: tc qdisc add|change|replace dev DEVICE root netem OPT",
        ),
        ("tc class add", "tc:1:4: 'class' is not allowed here"),
        (
            "tc qdisc add dev eth0 root tbf",
            "tc:1:28: 'tbf' is not allowed here; allowed: dev, parent, handle, root, netem",
        ),
        ("tc qdisc add dev", "tc:1:14: 'dev' should be followed by a value"),
        ("tc qdisc add dev eth0 root", "tc:1:23: 'root' should be followed by netem"),
        ("tc qdisc del dev eth0", "tc: no command adds netem, so nothing is read"),
        (
            "# link 0 -> 1\ntc qdisc add dev a root netem\n# link 0 -> 1\ntc qdisc add dev b root netem loss 1%",
            "tc:4:1: differs from the command above for link 0 -> 1",
        ),
        ("ip link set eth0 down", "tc:1:4: 'link' is not allowed here"),
        (
            "tc qdisc add dev a root netem\ntc qdisc add dev b root netem loss 1%",
            "tc:2:1: differs from the command above for",
        ),
        (
            "# link 0 -> 1\ntc qdisc add dev a root netem duplicate 1%",
            "tc: duplicate of link 0 -> 1 should be as for the",
        ),
        (
            "# link 1 -> 1\ntc qdisc add dev a root netem rate 1mbit",
            "tc: rate and limit of link 1 -> 1 should be as for",
        ),
    ],
)
def test_commands_that_are_none_of_netem_or_differ_are_refused(text, why):
    with pytest.raises(TcError, match=re.escape(why)):
        read_script(text)


MISSING = [
    (Links(range=5.0), "network.range: netem does not know positions"),
    (Links(graph=Ring()), "network.graph: netem does not remove links"),
    (Links(latency=Propagation()), "network.latency: netem needs quantiles"),
    (Links(latency=PerPair()), "network.latency: netem needs quantiles"),
    (Links(loss=ByDistance()), "network.loss: netem has no such model"),
    (Links(loss=GilbertElliott(advance="time")), "network.loss: netem has no such model"),
    (Links(duplicate=FourState()), "network.duplicate: netem has no such model"),
    (Links(latency=Uniform(), order="fifo"), "network.order: netem lets packets overtake each other here"),
    (Links(latency=Uniform(), medium=Bitrate(bitrate=1e6)), "network.order: netem keeps the order of packets here"),
    (Links(medium=LoRa()), "network.medium: netem has only a bit rate"),
    (Links(medium=Bitrate(bitrate=1.0, shared=True)), "network.medium.shared: "),
    (Links(medium=Bitrate(bitrate=1.0, half_duplex=True)), "network.medium.half_duplex: "),
    (Links(medium=Bitrate(bitrate=1.0, queue_limit=3)), "network.medium.queue_limit: "),
    (Links(medium=Bitrate(bitrate=1.0, access=Csma())), "network.medium.access: netem has no contention"),
    (Links(processing={"sender": Uniform()}), "network.processing.sender: netem has one delay: only the mean"),
    (Links(link=(Link(src=0, dst=1, loss=ByDistance()),)), "link 0 -> 1: loss: netem has no such model"),
]


def wrong(kind, **parameters):
    """Return a model of a user's class, whose methods do something else than those of the kind."""
    methods = {name: lambda self, *_: 5.0 for name in ("__call__", "draw") if hasattr(kind, name)}
    methods |= {"start_run": lambda self, size: self} if hasattr(kind, "start_run") else {}
    return type("Theirs", (kind,), {"__module__": "theirs", **methods})(**parameters)


MISSING += [
    (Links(latency=wrong(Constant, value=0.1)), "network.latency: netem needs quantiles"),
    (Links(latency=wrong(Uniform)), "network.latency: netem needs quantiles"),
    (Links(latency=wrong(Lognormal)), "network.latency: netem needs quantiles"),
    (Links(latency=wrong(Netem, jitter=0.01)), "network.latency: netem needs quantiles"),
    (Links(loss=wrong(Bernoulli, p=0.1)), "network.loss: netem has no such model"),
    (Links(loss=wrong(Correlated)), "network.loss: netem has no such model"),
    (Links(loss=wrong(GilbertElliott)), "network.loss: netem has no such model"),
    (Links(loss=wrong(FourState)), "network.loss: netem has no such model"),
    (Links(duplicate=wrong(Bernoulli, p=0.1)), "network.duplicate: netem has no such model"),
    (Links(medium=wrong(Bitrate, bitrate=1e6)), "network.medium: netem has only a bit rate"),
    (Links(latency=Uniform(low=5.0, high=15.0)), "network.latency: netem varies a delay by at most 2.14748 s"),
    (Links(latency=Lognormal(mean=50.0, cv=1.0)), "network.latency: netem varies a delay by at most 2.14748 s"),
]


@pytest.mark.parametrize(("links", "why"), MISSING)
def test_what_netem_cannot_express_is_listed(links, why):
    found = [": ".join(each) for each in script(links, SIZE).missing]
    assert len(found) == 1
    assert found[0].startswith(why)


def test_a_correlated_loss_has_both_shares():
    written = script(Links(loss=Correlated(p=0.1, correlation=0.5)), SIZE)
    assert written.lines[-1] == "tc qdisc add dev eth0 root netem loss random 10% 50%"
    assert written.missing == []


def test_processing_delays_are_added_and_edges_of_the_graph_count_as_links():
    """An edge without direction is two links; a link of its own precedes an edge."""
    edges = [{"src": 0, "dst": 1, "latency": 0.2}, {"src": 1, "dst": 2, "loss": 0.5}]
    links = Links(
        graph=Edges.model_validate({"edges": edges}),
        latency=Constant(value=0.1),
        processing=Processing(sender=0.01, receiver=0.02),
        link=(Link(src=1, dst=0, latency=Constant(value=0.3)),),
    )
    lines = script(links, 3, "wlan0").lines
    assert [line.removeprefix("tc qdisc add dev ") for line in lines if line.startswith("tc")] == [
        "wlan0 root netem delay 130ms",
        "wlan0-1-0 root netem delay 330ms",
        "wlan0-0-1 root netem delay 230ms",
        "wlan0-1-2 root netem delay 130ms loss random 50%",
        "wlan0-2-1 root netem delay 130ms loss random 50%",
    ]


def test_a_latency_of_a_user_with_a_kind_of_iproute2_has_a_table_of_its_own():
    class Normal(Lognormal):
        kind: Literal["normal"] = "normal"

    commands = script(Links(latency=Normal(mean=0.05, cv=0.5)), 2)
    assert "distribution desim-normal" in "\n".join(commands.lines)
    assert [*commands.tables] == ["desim-normal"]


def test_tables_of_one_kind_with_different_numbers_have_different_names():
    own = Link(src=0, dst=1, latency=Lognormal(cv=1.0))
    lines, tables, _ = script(Links(latency=Lognormal(), link=(own,)), SIZE)
    assert [*tables] == ["desim-lognormal", "desim-lognormal-2"]
    assert lines[-1].endswith("distribution desim-lognormal-2")


# Scripts of a shell.

RESULT = {"latency": {"kind": "constant", "value": 0.1}, "loss": {"kind": "bernoulli", "p": 0.1}}
ADD = "qdisc add dev eth0 root netem delay 100ms loss 10%"
SCRIPTS = [
    f"tc qdisc del dev eth0 root; tc {ADD}",
    f"tc qdisc del dev eth0 root && tc {ADD}",
    f"tc qdisc del dev eth0 root || tc {ADD}",
    f"tc qdisc del dev eth0 root;tc {ADD};",
    f"tc qdisc del dev eth0 root 2>/dev/null || true\ntc {ADD}",
    f"tc qdisc del dev eth0 root >/dev/null 2>&1; tc {ADD} > log",
    f"tc qdisc del dev eth0 root &>/dev/null || :; tc {ADD}",
    f"tc qdisc delete dev eth0 root\n\ttc {ADD} # as measured\n",
    f"#!/bin/sh\n/sbin/tc {ADD}\ntc qdisc show dev eth0\ntc -s qdisc ls",
    f"sudo /usr/sbin/tc -s -d {ADD}",
    f"sudo -E -u root env TC_LIB_DIR=/tmp tc {ADD}",
    f"docker exec -it -u root node1 tc {ADD}",
    f"sudo ip netns exec h1 tc {ADD}\nsudo ip netns exec h2 tc {ADD}",
    f"tc -n h1 {ADD}; tc -n h2 {ADD}",
    f"tc {ADD}\ntc qdisc del dev eth0 root",
    "tc q a dev 'eth0' root netem delay \"100ms\" loss 10\\%",
    "tc qdisc add dev eth0 root netem \\\n delay 100ms \\\r\n loss 10%",
    f"tc qdisc add dev eth0 root netem delay 7ms; tc {ADD.replace('add', 'change')}",
    f"tc qdisc add dev eth0 root netem delay 7ms loss 5% duplicate 2%; tc {ADD.replace('add', 'replace')}",
    f"tc qdisc add dev eth0 root netem rate 1mbit; tc qdisc del dev eth0 root; tc {ADD}",
    "tc qdisc add dev eth0 root netem rate 1mbit\ntc qdisc replace dev eth0 root handle 2: netem delay 100ms loss 10%",
    f"tc {ADD.replace('add', 'change')} || tc {ADD}",
    f"#!/bin/bash\nset -euo pipefail\necho 'a slow link'; tc {ADD} && echo done\ntc -s qdisc",
]


@pytest.mark.parametrize("script_of_shell", SCRIPTS)
def test_a_script_is_read_as_a_shell_reads_it(script_of_shell):
    assert read_script(script_of_shell) == (RESULT, [])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (f"tc {ADD} | tee log", "tc:1:55: '|' is not allowed here"),
        (f"tc {ADD} & sleep 1", "tc:1:55: '&' is not allowed here"),
        (f"for d in a b; do tc {ADD}; done", "tc:1:1: 'for' is not allowed here"),
        (f"sleep 1; tc {ADD}", "tc:1:1: 'sleep' is not allowed here"),
        (f"(tc {ADD})", "tc:1:1: '(' is not allowed here"),
        ("tc -b links.tc", "tc:1:4: '-b' is not allowed here: read the batch file itself"),
        ("tc qdisc del dev eth0 root", "tc: no command adds netem, so nothing is read; a command is: tc qdisc add"),
        ("# nothing", "tc: no command adds netem"),
        (f"tc {ADD}\ntc qdisc add dev eth0 root netem delay 1ms", "tc:2:1: differs from the command above"),
        (
            f"tc {ADD} 25%; tc qdisc change dev eth0 root netem loss 1%",
            "tc:1:60: leaves the correlations of the command before in effect",
        ),
        (f"tc {ADD} || tc qdisc change dev eth0 root netem delay 1ms", "tc:1:58: differs from the command before ||"),
        (f"docker run a tc {ADD}", "tc:1:8: 'run' is not allowed here"),
        ("tc qdisc link dev a root netem", "tc:1:10: 'link' is not allowed here"),
        ("tc qdisc add dev a root netem delay 1ms 'x", 'tc:1:41: "\'" is not allowed here'),
    ],
)
def test_a_script_that_does_other_things_is_refused(text, why):
    with pytest.raises(TcError, match=re.escape(why)):
        read_script(text)


def test_a_change_leaves_the_rate_and_the_table_of_a_distribution():
    """As in Linux (netem_change, net/sched/sch_netem.c); all other options that are not given are reset."""
    add = "tc qdisc add dev a root netem delay 10ms 2ms distribution normal loss 1% duplicate 2% rate 1mbit -42\n"
    network, _ = read_script(add + "tc qdisc change dev a root netem delay 30ms 3ms")
    assert network["latency"] == {"kind": "netem", "delay": 0.03, "jitter": 0.003, "distribution": "normal"}
    assert network["medium"] == {"kind": "bitrate", "bitrate": 1e6, "header": 0}
    assert not network.keys() & {"loss", "duplicate"}


def test_a_comment_names_the_link_of_its_line_or_of_the_next_command():
    text = """\
        tc qdisc add dev eth0 root netem
        # link 0 -> 1
        tc qdisc del dev eth1 root; tc qdisc add dev eth1 root netem loss 1%
        tc qdisc add dev eth2 root netem loss 2%  # link 1 -> 2
        tc qdisc change dev eth2 root netem loss 3%
        """
    assert read_script(text).network["link"] == [
        {"src": 0, "dst": 1, "loss": {"kind": "bernoulli", "p": 0.01}},
        {"src": 1, "dst": 2, "loss": {"kind": "bernoulli", "p": 0.03}},
    ]


@pytest.mark.parametrize(
    "text",
    [
        "DEV=eth0\nexport DELAY=100ms LOSS='10%'\ntc qdisc add dev $DEV root netem delay ${DELAY} loss $LOSS",
        'DEV=${1:-eth0}; D="100ms 0ms"\nD=100ms\ntc qdisc add dev "$DEV" root netem delay "${D}" loss ${LOSS:-10%}',
        "DEV=\necho tearing down links\ntc qdisc add dev ${DEV:-eth0} root netem delay ${D-100ms} loss 10%",
        "ip address add 10.0.0.1/24 dev eth0\nsudo ip link set eth0 up; modprobe ifb\nip netns add n\n"
        "ip netns exec n ip link set lo up && ip netns exec n tc qdisc add dev eth0 root netem delay 100ms loss 10%",
        'N="netem delay 100ms loss 10%"\ntc qdisc add dev eth0 root $N',
        "tc -s qdisc show dev eth0; tc qd ls\ntc qd add dev eth0 root netem delay 100ms loss 10%",
    ],
)
def test_variables_have_the_values_that_lines_above_give_them_and_addresses_no_effect(text):
    assert read_script(text).network == {
        "latency": {"kind": "constant", "value": 0.1},
        "loss": {"kind": "bernoulli", "p": 0.1},
    }


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("tc qdisc add dev a root netem delay $D", r"1:37: '\$D' .*; no line above gives this variable a value"),
        ("D=5ms\nD=$1\ntc qdisc add dev a root netem delay $D", r"3:37: '\$D' .*no line above"),
        ("D=5ms\ntc qdisc add dev a root netem delay '$D'", r"2:37: '\$D' .*no line above"),
        ("ip link set eth0 down", r"1:4: 'link' is not allowed here"),
        ("ip netns exec n ip link del a", r"'link' is not allowed here"),
        ("ip -all netns exec tc qdisc add dev a root netem delay 9ms", r"1:4: '-all' is not allowed here"),
        ("ip -n m netns exec n tc qdisc add dev a root netem delay 9ms", r"1:4: '-n' is not allowed here"),
        ("ip -batch commands.txt", r"1:4: '-batch' is not allowed here"),
    ],
)
def test_a_variable_without_a_value_and_the_end_of_a_link_are_refused(text, why):
    with pytest.raises(TcError, match=why):
        read_script(text)


RUNNERS = ["", "sudo ", "/sbin/", "sudo -n /usr/sbin/", "env A=1 ", "B=2 sudo "]
ENDS = [
    "\n",
    ";",
    " ; ",
    " && ",
    "\n\n# a comment; tc qdisc del dev a root\n",
    " # why not && tc\n",
    " 2>/dev/null || true\n",
]
GAPS = [" ", "  ", "\t", " \\\n\t"]


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["add", "change", "replace", "del", "delete"]),
            st.sampled_from(["a", "b"]),
            st.sampled_from([1, 2, 3]),
            *map(st.sampled_from, (RUNNERS, ENDS, GAPS)),
        ),
        max_size=6,
    )
)
def test_scripts_of_any_form_mean_what_their_commands_do(steps):
    """Against a list of the commands, applied to two devices one after the other."""
    text, delays, is_present = "", {}, {"a": False, "b": False}
    for action, device, delay, runner, end, gap in steps:
        is_deletion = action.startswith("del")
        words = [
            "tc",
            "qdisc",
            action,
            "dev",
            device,
            "root",
            *([] if is_deletion else ["netem", "delay", f"{delay}s"]),
        ]
        text += runner + gap.join(words) + end
        if not is_deletion and is_present[device] and action == "add":
            delays[device].append(delay)  # refused by Linux, and here, unless it is the same
        elif not is_deletion:
            delays[device] = [*delays[device][:-1], delay] if is_present[device] else [delay]
        is_present[device] = not is_deletion
    values = {delay for device in delays.values() for delay in device}
    if len(values) == 1:
        assert read_script(text).network == {"latency": {"kind": "constant", "value": float(*values)}}
    else:
        with pytest.raises(TcError, match="differs" if values else "nothing is read"):
            read_script(text)


@pytest.mark.slow
@given(st.sampled_from(["gemodel", "state"]), st.lists(st.integers(1, 9999), min_size=1, max_size=2))
@example("gemodel", [300, 4000])
@example("state", [100])
def test_bursts_that_are_printed_again_are_the_same(name, hundredths):
    values = [f"{number / 100:g}%" for number in hundredths]
    network = Links.model_validate(read_script(f"tc qdisc add dev a root netem loss {name} {' '.join(values)}").network)
    printed = script(network, SIZE).lines[1].partition("gemodel ")[2].split()
    assert printed == (values if len(values) == 2 else [*values, f"{(10_000 - hundredths[0]) / 100:g}%"])


@given(st.floats(0.0, 1.0))
def test_a_share_is_printed_as_the_shortest_text_with_its_number_of_steps(share):
    word = share_word(share)
    assert steps_of(share_of(word)) == steps_of(share)
    assert len(word) <= 15


@pytest.mark.parametrize("device", ["eth0", "br-lan", "wlan0.7", "veth@if3", "a_b", "x" * 15])
def test_a_device_may_have_a_usual_name(device):
    assert f"dev {device} root" in script(Links(), 2, device).lines[1]


@pytest.mark.parametrize(
    "device", ["", "x" * 16, "a b", "$(id)", "a;b", "`id`", "-a", "a/b", "\u00e9th0", "a\n", "'a'"]
)
def test_a_name_that_a_shell_or_linux_does_not_take_is_refused(device):
    with pytest.raises(ValueError, match="device: the name has at most 15 letters"):
        script(Links(), 2, device)


@pytest.mark.parametrize(
    ("commands", "delay"),
    [
        ("replace parent 5:1 netem delay 20ms; replace parent 5:2 netem delay 50ms", None),
        ("add parent 5:1 netem; add parent 5:2 netem; del parent 5:1; add parent 5:1 netem delay 50ms", None),
        ("add parent 5:1 netem; add parent 5:2 netem delay 50ms; change parent 5:1 netem delay 50ms", 0.05),
        ("add parent 5:1 netem; add parent 5:2 netem; del root; add root netem delay 50ms", 0.05),
        ("add parent 5:1 netem; add parent 5:2 netem; del parent 5:1; del parent 5:2; add root netem delay 50ms", 0.05),
        ("add parent 5:1 netem; add parent 5:2 netem delay 50ms; del parent 5:1; add root netem delay 50ms", 0.05),
    ],
)
def test_each_class_of_a_device_has_a_discipline_of_its_own(commands, delay):
    """A deletion of the root deletes all of a device."""
    text = re.sub(r"(add|change|replace|del) ", r"tc qdisc \1 dev eth0 ", commands)
    if delay is None:
        with pytest.raises(TcError, match="differs from the command above for the whole network"):
            read_script(text)
    else:
        assert read_script(text).network == {"latency": {"kind": "constant", "value": delay}}
