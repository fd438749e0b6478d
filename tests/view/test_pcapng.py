"""Capture files: scapy reads as many packets as messages were sent, with their times, addresses and sizes."""

import json
from collections import Counter
from decimal import Decimal
from types import SimpleNamespace

import pytest
import scapy.layers.inet  # registers IP for the link type
from scapy.utils import PcapNgReader

from desim import summary
from desim.kernel.core.events import Broadcast, MessageCounts, Sent
from desim.kernel.core.trace_file import body_json
from desim.kernel.core.units import SECOND
from desim.view.formats.pcapng import HEADERS, MAX_PAYLOAD, Pcapng
from tests.view.by_hand import history

IP, UDP = scapy.layers.inet.IP, scapy.layers.inet.UDP


def packets_of(events, folder):
    """Write a capture file; return its packets, and the messages: time (s), source, destination and size (bytes)."""
    file = folder / "x.pcapng"
    count = Pcapng()(SimpleNamespace(trace=events), file)
    with PcapNgReader(str(file)) as reader:
        packets = list(reader)
    assert len(packets) == count
    seen = [(each.time, _node(each[IP].src), _node(each[IP].dst), each.wirelen - HEADERS) for each in packets]
    return packets, seen


def _node(address):
    network, *number = map(int, address.split("."))
    assert network == 10
    return int.from_bytes(bytes(number), "big")


def messages_of(events):
    return [
        (Decimal(event.t) / SECOND, event.src, dst, event.size)
        for event in events
        if isinstance(event, Broadcast | Sent)
        for dst, _ in event.fates()
    ]


@pytest.mark.whole
@pytest.mark.parametrize(
    "asked",
    [
        ("recorded.toml", "horizon=0.2"),
        *(
            pytest.param((name, "horizon=1.0", "record.messages=true"), marks=pytest.mark.slow)
            for name in ("relay.toml", "token_ring.toml", "contention.toml", "lora.toml")
        ),
    ],
    ids=lambda asked: asked[0],
)
def test_scapy_counts_the_messages_of_a_run(asked, run_of, tmp_path):
    """All that were sent, but for those that still wait or were dropped from a queue; none of these runs drops any."""
    result = run_of(*asked)
    _, seen = packets_of(result.trace, tmp_path)
    assert seen == messages_of(result.trace)
    numbers = summary(result)
    queued = {
        (event.transmission, dst) for event in result.trace if type(event).__name__ == "Queued" for dst in event.dst
    }
    begun = {
        (event.transmission, dst) for event in result.trace if hasattr(event, "created") for dst, _ in event.fates()
    }
    assert len(seen) == numbers.messages_sent - len(queued - begun)
    if asked[0] in {"recorded.toml", "relay.toml"}:
        assert len(seen) == numbers.messages_sent > 0


def test_a_packet_is_a_valid_datagram_with_the_content_in_its_comment(tmp_path):
    trace = history().trace
    packets, seen = packets_of(trace, tmp_path)
    assert seen[:3] == [(Decimal("0.1"), 0, 1, 24), (Decimal("0.1"), 0, 2, 24), (Decimal("0.3"), 2, 0, 32)]
    for packet, (_, _, _, size) in zip(packets, seen, strict=True):
        checksum = packet[IP].chksum
        again = packet[IP].copy()
        del again.chksum
        assert IP(bytes(again)).chksum == checksum
        assert (packet[UDP].sport, packet[UDP].dport) == (49152, 49152)  # the first that nobody can register (RFC 6335)
        assert packet[IP].len == packet[UDP].len + 20 == size + HEADERS
        assert bytes(packet[UDP].payload) == bytes(size)
    assert Counter(packet[IP].id for packet in packets) == {0: 2, 1: 1, 3: 2}
    assert [packet.comment for packet in packets][2] == b'["token", Infinity]'


@pytest.mark.own_trace
def test_times_are_in_nanoseconds_and_numbers_of_nodes_may_be_large(tmp_path):
    """A time of more than 32 bits, the last of a million nodes, and a number of a transmission of more than 16 bits."""
    event = Sent((1 << 35) + 1, (1 << 16) + 7, 999_999, 65_536, 1 << 36, 0, 16, "x")
    (packet,), seen = packets_of([event], tmp_path)
    assert seen == [(Decimal("34.359738369"), 999_999, 65_536, 16)]
    assert packet[IP].id == 7


@pytest.mark.own_trace
@pytest.mark.parametrize("size", [MAX_PAYLOAD, MAX_PAYLOAD + 1, 200_000])
def test_a_message_of_any_size_is_a_packet_of_its_length(tmp_path, size):
    (packet,), seen = packets_of([Sent(5, 0, 0, 1, 9, 5, size, [0.5] * 20_000)], tmp_path)
    assert seen[0][-1] == size
    assert packet[IP].len == (size + HEADERS if size <= MAX_PAYLOAD else 0)
    assert b"".join(packet.comments).decode() == body_json([0.5] * 20_000)
    assert [len(comment) for comment in packet.comments] == [0xFFFF, 100_000 - 0xFFFF]


@pytest.mark.own_trace
def test_a_run_without_recorded_messages_is_refused(tmp_path):
    trace = history(messages=False).trace
    with pytest.raises(ValueError, match=r"the trace lacks the messages that were sent: set record\.messages = true"):
        Pcapng()(SimpleNamespace(trace=trace), tmp_path / "x.pcapng")
    silent = [event._replace(sent=0) if isinstance(event, MessageCounts) else event for event in trace]
    assert packets_of(silent, tmp_path) == ([], [])


@pytest.mark.slow
def test_the_comment_of_a_packet_is_json(run_of, tmp_path):
    result = run_of("recorded.toml", "horizon=0.2")
    packets, _ = packets_of(result.trace, tmp_path)
    assert {tuple(json.loads(packet.comment)) for packet in packets} == {("records", "hops")}


def test_each_block_of_a_capture_has_its_length_at_both_ends(tmp_path):
    """As the specification of pcapng has it (draft-ietf-opsawg-pcapng, section 3.1), which few readers check."""
    Pcapng()(history(), tmp_path / "x.pcapng")
    data, lengths = (tmp_path / "x.pcapng").read_bytes(), []
    while data:
        length = int.from_bytes(data[4:8], "little")
        assert length % 4 == 0
        assert data[length - 4 : length] == data[4:8]
        lengths.append(length)
        data = data[length:]
    assert len(lengths) == 2 + len(messages_of(history().trace))
