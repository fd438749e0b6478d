"""Reserved ports: no message of a protocol reaches the inboxes of the simulator and of protocols."""

import importlib
import pkgutil

import pytest

import desim
import protocols
from desim import Scenario, run
from desim.kernel.core.ports import ReservedPort
from tests.test_pickling import copies_of

MODULES = [
    importlib.import_module(module.name)
    for package in (desim, protocols)
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
]
PORTS = sorted({port for module in MODULES for port in vars(module).values() if isinstance(port, ReservedPort)})


def test_every_port_of_the_simulator_is_reserved():
    """A port is a text; the port of pcapng is a number."""
    ports = [vars(module)["PORT"] for module in MODULES if "PORT" in vars(module)]
    assert {port for port in ports if isinstance(port, str)} == set(PORTS)
    assert len(PORTS) >= 8
    assert len({str(port) for port in PORTS}) == len(PORTS)


def test_a_reserved_port_is_equal_to_itself_and_to_no_text():
    for port in PORTS:
        assert (port == port) is True
        assert (port != port) is False
        assert (port == str(port)) is False
        assert (port != str(port)) is True


def test_the_names_of_reserved_ports_in_traces_and_logs_stay():
    assert sorted(map(str, PORTS)) == [
        "accusations",
        "announcements",
        "clock synchronisation",
        "forged announcements",
        "mutex",
        "server",
        "sightings",
        "token",
        "transport frames",
    ]


@pytest.mark.parametrize("port", PORTS, ids=str)
def test_a_reserved_port_is_no_other_text_and_one_object_in_every_copy(port):
    text = str(port)
    assert type(text) is str
    assert port != text
    assert text != port
    assert {port: 1, text: 2} == {port: 1, str(port): 2}
    assert all(again is port for again in copies_of(port))


def talking(port):
    """Return a protocol that sends on a port, and answers what it gets there."""

    def talk(me):
        for k in range(5):
            me.send(None, (me.id, k), port)
            me.send((me.id + 1) % 3, "text", port)
            yield me.arrival(port) | me.sleep(0.1)
            got.append((me.id, me.now, [(message.src, message.body) for message in me.mail(port)]))

    got = []
    return talk, got


@pytest.mark.slow
@pytest.mark.parametrize("port", PORTS, ids=str)
def test_a_protocol_may_use_the_text_of_a_reserved_port_for_its_own(port):
    """All parts that have ports take part: transports, clocks, sensors, liars, trust and dissemination."""
    runs = []
    for name in (str(port), "its own"):
        talk, got = talking(name)
        scenario = Scenario(
            team={"count": 3},
            horizon=0.6,
            protocol=talk,
            sensing={"radius": 8.0},
            clocks={"sync": {"kind": "two_way", "interval": 0.1}},
            announce={"trust": "accusations", "dissemination": "flooding", "heartbeat": 0.1},
            network={"latency": 0.01, "loss": 0.2, "transport": "reliable"},
            fault=[
                {"kind": "clock_skew", "offset": 0.01},
                {"kind": "spoof", "start": 0.0, "node": 1, "victim": 0},
                {"kind": "slander", "start": 0.0, "node": 2, "accused": [0]},
            ],
            record={"messages": True},
        )
        runs.append(([(type(event), event.t) for event in run(scenario, 1).trace], got))
    assert runs[0] == runs[1]
    assert len(runs[0][1]) == 15
