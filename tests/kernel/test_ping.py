"""The output of ping as a trace and as a list of latencies."""

import pytest

from desim import Empirical, LatencyTrace, LossTrace
from desim.config.errors import KeyedError
from desim.kernel.measured.ping import MAX_PROBES, WRAP, probes_of

LINUX = """\
PING 10.0.0.2 (10.0.0.2) 56(84) bytes of data.
64 bytes from 10.0.0.2: icmp_seq=1 ttl=64 time=12.3 ms
64 bytes from host.lan (10.0.0.2): icmp_seq=2 ttl=64 time=1003 ms
64 bytes from 10.0.0.2: icmp_seq=4 ttl=64 time=0.045 ms
64 bytes from 10.0.0.2: icmp_seq=4 ttl=64 time=0.945 ms (DUP!)
From 10.0.0.5 icmp_seq=5 Destination Host Unreachable

--- 10.0.0.2 ping statistics ---
6 packets transmitted, 3 received, +1 duplicates, +1 errors, 50% packet loss, time 1000ms
rtt min/avg/max/mdev = 0.045/338.448/1003.000/470.1 ms
"""
STAMPED = """\
[1700000000.500000] 64 bytes from 10.0.0.2: icmp_seq=1 ttl=64 time=500 ms
[1700000002.200000] no answer yet for icmp_seq=2
[1700000003.500000] 64 bytes from 10.0.0.2: icmp_seq=3 ttl=64 time=500 ms
"""
MACOS = """\
PING 8.8.8.8 (8.8.8.8): 56 data bytes
Request timeout for icmp_seq 0
64 bytes from 8.8.8.8: icmp_seq=1 ttl=118 time=12.345 ms

--- 8.8.8.8 ping statistics ---
3 packets transmitted, 1 packets received, 66.7% packet loss
"""
UNEVEN = """\
PING 10.0.0.2 (10.0.0.2) 56(84) bytes of data.
[100.5] 64 bytes from 10.0.0.2: icmp_seq=2 ttl=64 time=500 ms
[101.5] 64 bytes from 10.0.0.2: icmp_seq=4 ttl=64 time=500 ms
[105.5] 64 bytes from 10.0.0.2: icmp_seq=5 ttl=64 time=500 ms

--- 10.0.0.2 ping statistics ---
6 packets transmitted, 3 received, 50% packet loss, time 5000ms
"""
BUSYBOX = "PING 1.1.1.1 (1.1.1.1): 56 data bytes\n64 bytes from 1.1.1.1: seq=0 ttl=57 time=3.611 ms\n"
FIRST_LOST = """\
PING 1.1.1.1 (1.1.1.1): 56 data bytes
64 bytes from 1.1.1.1: seq=1 ttl=57 time=3.611 ms

--- 1.1.1.1 ping statistics ---
3 packets transmitted, 1 packets received, 66% packet loss
"""
FIRST_LOST_IPV6 = """\
PING6(56=40+8+8 bytes) ::1 --> ::1
16 bytes from ::1, icmp_seq=1 hlim=64 time=3.611 ms

--- ::1 ping6 statistics ---
3 packets transmitted, 1 packets received, 66.7% packet loss
"""
WINDOWS_IPV6 = (
    "Pinging ::1 with 32 bytes of data:\nReply from ::1: time<1ms \nRequest timed out.\nReply from ::1: time=3ms\n"
    "Destination host unreachable.\n"
)
WINDOWS = """\
Pinging 1.1.1.1 with 32 bytes of data:
Reply from 1.1.1.1: bytes=32 time=12ms TTL=57
Request timed out.
Reply from 1.1.1.1: bytes=32 time<1ms TTL=57
Reply from 192.168.0.2: Destination host unreachable.
PING: transmit failed. General failure.

Ping statistics for 1.1.1.1:
    Packets: Sent = 5, Received = 2, Lost = 3 (60% loss),
"""
OUTPUTS = {
    LINUX: [(0.0, 0.0123), (0.2, 1.003), (0.4, None), (0.6, 0.000045), (0.8, None), (1.0, None)],
    STAMPED: [(1_700_000_000.0, 0.5), (1_700_000_001.5, None), (1_700_000_003.0, 0.5)],
    UNEVEN: [
        *((100.0 - 5.0 / 3.0, None), (100.0, 0.5), (100.5, None), (101.0, 0.5), (105.0, 0.5)),
        (105.0 + 5.0 / 3.0, None),
    ],
    MACOS: [(0.0, None), (1.0, 0.012345), (2.0, None)],
    BUSYBOX: [(0.0, 0.003611)],
    FIRST_LOST: [(0.0, None), (1.0, 0.003611), (2.0, None)],
    FIRST_LOST_IPV6: [(0.0, None), (1.0, 0.003611), (2.0, None)],
    WINDOWS_IPV6: [(0.0, 0.001), (1.0, None), (2.0, 0.003), (3.0, None)],
    WINDOWS: [(0.0, 0.012), (1.0, None), (2.0, 0.001), (3.0, None), (4.0, None)],
}


@pytest.mark.parametrize(
    "text",
    OUTPUTS,
    ids=[
        "Linux",
        "with times",
        "uneven times",
        "macOS",
        "BusyBox",
        "first lost",
        "first lost, IPv6",
        "Windows, IPv6",
        "Windows",
    ],
)
def test_each_probe_has_its_time_and_its_round_trip(text):
    """A lost one has a time between those of its neighbours."""
    probes = probes_of(text)
    assert [rtt for _, rtt in probes] == [rtt and pytest.approx(rtt) for _, rtt in OUTPUTS[text]]
    assert [sent for sent, _ in probes] == pytest.approx([sent for sent, _ in OUTPUTS[text]], abs=1e-6)


def test_sequence_numbers_go_on_after_the_last_and_a_log_may_begin_later():
    reply = "64 bytes from a: icmp_seq={} ttl=64 time=1 ms\n"
    text = "".join(reply.format(seq % WRAP) for seq in (WRAP - 2, WRAP - 1, WRAP + 1))
    assert [rtt for _, rtt in probes_of(text)] == [0.001, 0.001, None, 0.001]
    assert [rtt for _, rtt in probes_of(f"PING a\n{reply.format(3)}")] == [None, None, 0.001]
    assert [rtt for _, rtt in probes_of("Pinging a\nReply from a: time=1ms\n")] == [0.001]


@pytest.mark.parametrize("text", ["", "0.1 0.2", "time=0.1", "a table\nwith time=0.1 and time<1\n"])
def test_a_text_without_a_reply_has_no_probes(text):
    assert probes_of(text) == []


NO_REPLY = {
    "Linux": "PING a (10.0.0.2) 56(84) bytes of data.\n\n--- a ping statistics ---\n"
    "5 packets transmitted, 0 received, 100% packet loss, time 4000ms\n",
    "Linux -O": "PING a (10.0.0.2) 56(84) bytes of data.\n"
    + "".join(f"no answer yet for icmp_seq={seq}\n" for seq in range(1, 5))
    + "\n--- a ping statistics ---\n5 packets transmitted, 0 received, 100% packet loss, time 4149ms\n",
    "macOS": "PING a (10.0.0.2): 56 data bytes\n"
    + "".join(f"Request timeout for icmp_seq {seq}\n" for seq in range(4))
    + "\n--- a ping statistics ---\n5 packets transmitted, 0 packets received, 100.0% packet loss\n",
    "macOS, IPv6": "PING6(56=40+8+8 bytes) ::1 --> ::2\n\n--- ::2 ping6 statistics ---\n"
    "5 packets transmitted, 0 packets received, 100.0% packet loss\n",
    "Windows": "Pinging 10.0.0.2 with 32 bytes of data:\n"
    + 5 * "Request timed out.\n"
    + "\nPing statistics for 10.0.0.2:\n    Packets: Sent = 5, Received = 0, Lost = 5 (100% loss),\n",
}


@pytest.mark.parametrize("text", NO_REPLY.values(), ids=NO_REPLY)
def test_without_a_reply_all_probes_are_lost(text, tmp_path):
    (tmp_path / "ping.txt").write_text(text)
    assert LossTrace(file=str(tmp_path / "ping.txt"), value="lost").measurements.values.tolist() == [1.0] * 5
    with pytest.raises(KeyedError, match=r"ping\.txt: ping had no reply, so there is no latency"):
        Empirical(file=str(tmp_path / "ping.txt"))


def test_a_summary_of_ping_is_refused(tmp_path):
    """As printed with the option -q."""
    (tmp_path / "ping.txt").write_text(NO_REPLY["Linux"].replace(" 0 received", " 4 received"))
    for model in (Empirical, LossTrace):
        with pytest.raises(KeyedError, match=r"ping\.txt has the summary of ping only; without the option -q"):
            model(file=str(tmp_path / "ping.txt"))


def test_a_file_of_ping_is_a_list_of_latencies_and_a_table(tmp_path):
    file = tmp_path / "ping.txt"
    file.write_text(LINUX)
    assert Empirical(file=str(file)).values == pytest.approx((0.00615, 0.5015, 0.0000225))
    latency = LatencyTrace(file=str(file), value="rtt_ms", unit="ms", rtt=True)
    loss = LossTrace(file=str(file), value="lost")
    assert latency.measurements.times.tolist() == [0, 2 * 10**8, 4 * 10**8, 6 * 10**8, 8 * 10**8, 10**9]
    assert latency.measurements.is_missing.tolist() == [False, False, True, False, True, True]
    assert loss.measurements.values.tolist() == [0, 0, 1, 0, 1, 1]
    with pytest.raises(KeyedError, match="has no column 'value'; its columns are t, rtt_ms, lost"):
        LatencyTrace(file=str(file))


@pytest.mark.parametrize("model", [Empirical, LatencyTrace])
def test_several_outputs_and_endless_ones_are_refused(model, tmp_path):
    for text, why in {
        LINUX + LINUX: "has the output of several pings",
        LINUX.replace("6 packets", f"{MAX_PROBES + 1} packets"): "has more than 10,000,000 probes",
    }.items():
        (tmp_path / "ping.txt").write_text(text)
        with pytest.raises(KeyedError, match=rf"ping\.txt {why}"):
            model(file=str(tmp_path / "ping.txt"))


@pytest.mark.parametrize("time", ["time=12300 us", "time=0.0123 s", "time=12", "time=a", "12:00:01 time=12"])
def test_a_reply_whose_time_cannot_be_read_is_not_a_lost_probe(time):
    """A file may be cut in its last line, for example."""
    with pytest.raises(ValueError, match=f"the text has a reply that cannot be read: .*{time}.* should be in ms"):
        probes_of(LINUX.replace("time=12.3 ms", time, 1))


def test_a_decimal_comma_of_a_locale_is_not_a_lost_probe():
    """Round trips of 100 ms or more have no decimals, so that only the others have a comma."""
    assert probes_of(LINUX.replace("12.3 ms", "12,3 ms").replace("0.045 ms", "0,045 ms")) == probes_of(LINUX)
