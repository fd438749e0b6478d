"""Airtimes against the data sheet, and the presets."""

import json
from fractions import Fraction
from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from desim import Scenario, Team, run
from desim.analysis.trace_index import messages
from desim.config.errors import KeyedError
from desim.kernel.models.access import Aloha, Csma, CsmaCa, SlottedAloha, Tdma
from desim.kernel.models.interference import LoRaInterference
from desim.kernel.models.latency import Constant, Gamma, Propagation, ShiftedExponential, Uniform
from desim.kernel.models.links import Links
from desim.kernel.models.medium import Bitrate, LoRa, Unlimited, airtime_of, channel_of
from desim.kernel.models.presets import PRESETS
from tests.golden import golden

DATA_SHEET = {7: 61.7, 8: 113.2, 9: 205.8, 10: 370.7, 11: 823.3, 12: 1482.8}
"""Airtime of 24 bytes by spreading factor, ms, at 125 kHz, 4/5, with header and checksum."""


def test_a_bitrate_takes_8_bits_a_byte_of_message_and_header_and_an_unlimited_medium_no_time():
    """24 bytes and a header of 26 at 250 kbit/s: 400 / 250 000 = 1.6 ms."""
    assert Bitrate(bitrate=250_000.0, header=26)(24) == pytest.approx(0.0016, rel=1e-12)
    assert [Bitrate(bitrate=1000.0)(size) for size in (24, 0)] == pytest.approx([0.192, 0.0], rel=1e-12)
    assert [Unlimited()(size) for size in (0, 24, 10**6)] == [0.0, 0.0, 0.0]


class Given:
    """A medium of a user, with the same airtime for every message."""

    shared, half_duplex, queue_limit = False, False, inf

    def __init__(self, airtime):
        self.seconds = airtime

    def __call__(self, size):
        return self.seconds


@pytest.mark.parametrize("medium", [Given(1e300), Given(10**30), LoRa(bandwidth=1.0, preamble=10**6)])
@pytest.mark.parametrize("latency", [Constant(value=0.1), Uniform(low=0.0, high=1.0), ShiftedExponential(mean=1e9)])
def test_a_message_that_is_on_the_air_for_ever_never_arrives(medium, latency):
    """In whole nanoseconds such a time would not fit 64 bits."""
    found = run(Scenario(team=Team(count=3), horizon=2.0, network=Links(medium=medium, latency=latency)), 1)
    counts = messages(found)
    assert (counts.delivered, counts.in_flight) == (0, counts.sent)
    assert counts.sent > 0


def test_a_bandwidth_is_at_least_one_hertz_as_a_bitrate_is_at_least_one_bit_per_second():
    for wrong in (lambda: LoRa(bandwidth=0.5), lambda: Bitrate(bitrate=0.5)):
        with pytest.raises(KeyedError, match="greater than or equal to 1"):
            wrong()


def data_sheet(size, factor, bandwidth, rate, preamble, crc, implicit):
    """Return the airtime of a frame as a fraction, s: SX1276 data sheet (rev. 7), 4.1.1.7, in whole numbers.

    T_sym = 2^SF / BW, T_preamble = (n_preamble + 4.25) T_sym,
    payloadSymbNb = 8 + max(ceil((8 PL - 4 SF + 28 + 16 CRC - 20 IH) / (4 (SF - 2 DE))) (CR + 4), 0),
    where low data rate optimisation DE is on if a symbol takes 16 ms or more.
    """
    symbol = Fraction(2**factor, bandwidth)
    slow = 1 if 1000 * symbol >= 16 else 0
    above = 8 * size - 4 * factor + 28 + (16 if crc else 0) - (20 if implicit else 0)
    blocks = -(-above // (4 * factor - 8 * slow))
    return (preamble + Fraction(17, 4) + 8 + max(blocks * (4 + rate), 0)) * symbol


@pytest.mark.slow
@given(
    size=st.integers(0, 255),
    factor=st.integers(7, 12),
    bandwidth=st.sampled_from([7800, 10400, 15600, 20800, 31250, 41700, 62500, 125_000, 250_000, 500_000]),
    rate=st.integers(1, 4),
    preamble=st.integers(6, 65_535),
    crc=st.booleans(),
    implicit=st.booleans(),
)
def test_the_airtime_of_every_lora_frame_follows_the_data_sheet(size, factor, bandwidth, rate, preamble, crc, implicit):
    ours = LoRa(
        spreading_factor=factor,
        bandwidth=float(bandwidth),
        coding_rate=rate,
        preamble=preamble,
        crc=crc,
        implicit_header=implicit,
    )
    theirs = data_sheet(size, factor, bandwidth, rate, preamble, crc, implicit)
    assert ours(size) == pytest.approx(float(theirs), rel=1e-12)


@pytest.mark.slow
@given(st.integers(0, 9), st.integers(1, 255), st.sampled_from([7, 12]))
def test_a_message_that_is_too_long_for_a_lora_frame_takes_several(full, rest, factor):
    """Of 255 bytes each, and one of what is left: 256 bytes take a full frame and one of a single byte."""
    frame = LoRa(spreading_factor=factor)
    assert frame(full * 255 + rest) == pytest.approx(full * frame(255) + frame(rest), rel=1e-12)


def test_a_long_message_over_lora_by_hand():
    """SF 7: ceil((2040 - 28 + 28 + 16) / 28) = 74 blocks of 5, 12.25 + 8 + 370 = 390.25 symbols of 1.024 ms a frame; a
    byte takes ceil(24 / 28) = 1 block, 25.25 symbols. In one frame 256 bytes would take 390.25 as well.
    """
    assert [LoRa()(size) / 0.001024 for size in (255, 256, 510)] == pytest.approx([390.25, 415.5, 780.5], rel=1e-12)


def test_slow_symbols_carry_two_bits_less():
    """At 125 kHz a symbol of SF 10 takes 8.2 ms, of SF 11 16.4 ms; at 250 kHz that of SF 12 does.

    The control: without it 24 bytes would take ceil(188 / 48) = 4 blocks at SF 12 instead of 5, 1318.9 ms.
    """
    assert LoRa(spreading_factor=12)(24) * 1e3 != pytest.approx(1318.912, abs=0.05)
    assert LoRa(spreading_factor=12, bandwidth=250_000.0)(24) == LoRa(spreading_factor=12)(24) / 2
    assert LoRa(spreading_factor=12, bandwidth=500_000.0)(24) * 4e3 == pytest.approx(1318.912, abs=0.05)


def test_a_queue_is_unlimited_by_default_and_infinity_survives_json():
    assert Bitrate(bitrate=1.0).queue_limit == inf
    assert Bitrate.model_validate(Bitrate(bitrate=1.0).plain()) == Bitrate(bitrate=1.0)
    assert Bitrate(bitrate=1.0, queue_limit=3).queue_limit == 3


def test_a_duty_cycle_and_the_slots_of_a_tdma_delay_the_next_message():
    """10 ms on the air: with a duty cycle of 5 % 200 ms, and with three slots of 50 ms rounds of 150 ms."""
    slots = Tdma(slot=0.05)
    for access, duty_cycle, expected in (
        (Aloha(), None, 0.01),
        (Aloha(), 0.05, 0.2),
        (slots, None, 0.15),
        (slots, 0.1, 0.15),
        (slots, 0.05, 0.3),
    ):
        medium = Bitrate(bitrate=8000.0, access=access, duty_cycle=duty_cycle)
        assert medium.interval(10, 3) == pytest.approx(expected)
    assert Bitrate(bitrate=8000.0, access=slots).interval(0, 3) == pytest.approx(0.15)  # a round for no airtime, too


def test_a_message_occupies_the_channel_for_longer_than_its_airtime():
    """10 ms on the air: whole slots of 4 ms, or DIFS before it, and SIFS and an acknowledgement after it."""
    wifi = CsmaCa(sifs=1e-3, difs=2e-3, ack=3e-3)
    for access, to_all, to_one in (
        (Aloha(), 0.01, 0.01),
        (SlottedAloha(slot=0.004), 0.012, 0.012),
        (Tdma(slot=0.05), 0.01, 0.01),
        (wifi, 0.012, 0.016),
    ):
        medium = Bitrate(bitrate=8000.0, access=access)
        assert medium.occupancy(10, 3) == pytest.approx(to_all)
        assert medium.occupancy(10, 3, to_one=True) == pytest.approx(to_one)
    fits = Bitrate(bitrate=250_000.0, access=SlottedAloha(slot=1.28e-4))  # 5 slots, whose float quotient is above 5
    assert fits.occupancy(20, 3) == pytest.approx(fits(20))


def test_frames_of_one_instant_overlap_for_an_airtime_or_a_slot_or_until_they_are_sensed():
    """Where one of two nodes starts first, each with probability p a slot, both do with probability p / (2 - p)."""
    for access, channel in (
        (Aloha(), (0.01, 0.01, 1.0)),
        (SlottedAloha(slot=0.004), (0.01, 0.01, 1.0)),
        (SlottedAloha(slot=0.05, p=0.5), (0.05, 0.05, 1 / 3)),
        (Csma(sensing_delay=1e-4, p=0.5), (1e-4, 0.01, 1.0)),
        (Csma(persistence="p_persistent", p=0.5), (0.0, 0.01, 1 / 3)),
        (CsmaCa(), (0.0, 0.01, 1.0)),
        (Tdma(slot=0.05), None),
    ):
        assert channel_of(Bitrate(bitrate=8000.0, access=access), 0.01) == channel
    assert channel_of(Bitrate(bitrate=8000.0, half_duplex=True), 0.01) == (0.01, 0.01, 1.0)
    for alone in (Bitrate(bitrate=8000.0), Bitrate(bitrate=8000.0, half_duplex=True, shared=True), Unlimited()):
        assert channel_of(alone, 0.01) is None


def test_the_airtime_of_a_message_is_that_of_the_slowest_node():
    medium = LoRa(access=Aloha(), spreading_factors=(7, 12, 9))
    assert medium(24) == medium.airtime(24, 1) == LoRa(spreading_factor=12)(24)
    assert medium.airtime(24, 0) == LoRa()(24)


class SlowerByNode(LoRa):
    """A medium of a user: each node takes a tenth of a second longer than the one before."""

    def airtime(self, size, node):
        return 0.1 * (node + 1)


def test_a_medium_of_a_user_is_asked_for_the_airtime_of_each_node():
    medium = SlowerByNode(access=Aloha(), spreading_factors=(7, 8, 9))
    assert airtime_of(medium, 24, 3) == pytest.approx(0.3)
    with pytest.raises(ValueError, match=r"should have one for each of 4 nodes \(got 3\)"):
        airtime_of(medium, 24, 4)


# Presets.


def test_the_presets_are_the_ones_that_are_described():
    """Guesses: wifi 0.25 ms + Exp(0.25 ms) twice; lte 20 ms + Gamma(2, 10 ms), 5g 5 ms + Gamma(2, 3 ms)."""
    assert Links(preset="wifi").latency == ShiftedExponential(offset=0.00025, mean=0.00025)
    assert Links(preset="wifi").processing.sender == ShiftedExponential(offset=0.00025, mean=0.00025)
    assert Links(preset="lte").latency == Gamma(offset=0.020, shape=2.0, scale=0.010)
    assert Links(preset="5g").latency == Gamma(offset=0.005, shape=2.0, scale=0.003)
    assert Links(preset="satellite").latency == Constant(value=0.270)
    assert Links(preset="acoustic").latency == Propagation(speed=1500.0)
    assert Links(preset="acoustic").medium(100) == pytest.approx(0.16)
    assert Links(preset="acoustic").medium.half_duplex


@pytest.mark.parametrize(("factor", "airtime"), DATA_SHEET.items())
def test_24_bytes_over_lora_take_the_time_of_the_data_sheet_and_its_presets_contend(factor, airtime):
    medium = Links(preset=f"lora_sf{factor}").medium
    for each in (medium, LoRa(spreading_factor=factor)):
        assert each(24) * 1e3 == pytest.approx(airtime, abs=0.05)
    assert (medium.access, medium.spreading_factor, medium.duty_cycle) == (Aloha(), factor, 0.01)
    assert medium.reception == LoRaInterference()


def test_a_wifi_frame_takes_the_time_of_the_standard_up_to_a_symbol():
    """IEEE 802.11 at 6 Mbit/s: 20 us, a symbol of 4 us per 24 bits with 22 bits and headers of 64 bytes, and 6 us."""
    medium = Links(preset="wifi").medium
    for size in (0, 24, 200, 1472):
        symbols = -(-(22 + 8 * (64 + size)) // 24)
        assert 0.0 <= (20 + 4 * symbols + 6) * 1e-6 - medium(size) < 4e-6
    assert medium.access.ack == pytest.approx((20 + 4 * -(-(22 + 8 * 14) // 24) + 6) * 1e-6)
    assert medium.access.difs == pytest.approx(medium.access.sifs + 2 * medium.access.slot)
    assert CsmaCa().ack == pytest.approx((20 + 4 * -(-(22 + 8 * 14) // 96) + 6) * 1e-6)


@pytest.mark.parametrize("name", PRESETS)
def test_values_given_beside_a_preset_override_it(name):
    links = Links.model_validate(
        {"preset": name, "latency": {"kind": "constant", "value": 1.0}, "medium": {"kind": "unlimited"}, "range": 5.0}
    )
    assert (links.latency, links.medium, links.range) == (Constant(value=1.0), Unlimited(), 5.0)
    assert Links.model_validate(Links(preset=name).plain()) == Links(preset=name)


def test_every_preset_has_a_name_that_links_know_and_no_other():
    with pytest.raises(KeyedError):
        Links(preset="carrier pigeon")
    assert all(Links(preset=name).preset == name for name in PRESETS)
    assert Links() == Links(preset=None)


def test_the_means_of_the_presets_are_those_of_their_kind():
    """Of 10^5 draws, within 5 standard errors sd / sqrt(n): 0.5 (of one end), 40 and 11 ms; the control is 3 % off."""
    for name, mean, deviation in (
        ("wifi", 0.0005, 0.00025),
        ("lte", 0.040, 0.010 * 2**0.5),
        ("5g", 0.011, 0.003 * 2**0.5),
    ):
        draws = Links(preset=name).latency.draw(100_000, np.random.default_rng(1))
        error = deviation / 100_000**0.5
        assert abs(draws.mean() - mean) < 5 * error
        assert abs(draws.mean() - 1.03 * mean) > 5 * error


@pytest.mark.parametrize("given", [{"kind": "lora", "queue_limit": 3}, {"queue_limit": 3}], ids=["kind", "no kind"])
def test_a_table_that_a_preset_has_too_is_completed_from_it(given):
    """What is given counts, what is not is the preset's: one may wait, and it stays SF 12 with ALOHA."""
    rest = {"access": Aloha(), "reception": LoRaInterference(), "duty_cycle": 0.01}
    medium = Links(preset="lora_sf12", medium=given).medium
    assert medium == LoRa(spreading_factor=12, queue_limit=3, **rest)
    assert Links(preset="lora_sf12").medium == LoRa(spreading_factor=12, queue_limit=1, **rest)


def test_the_tables_in_a_table_are_completed_from_a_preset_too():
    preset = Links(preset="wifi").medium
    for table in ({"window": 32}, {"kind": "csma_ca", "window": 32}):
        medium = Links(preset="wifi", medium={"access": table}).medium
        assert medium == preset.model_copy(update={"access": preset.access.model_copy(update={"window": 32})})
    other = Links(preset="wifi", medium={"access": {"kind": "aloha"}}).medium
    assert other == preset.model_copy(update={"access": Aloha()})


def test_a_table_of_another_kind_than_the_preset_s_is_not_mixed_with_it():
    medium = Links(preset="lora_sf12", medium={"kind": "bitrate", "bitrate": 100.0}).medium
    assert medium == Bitrate(bitrate=100.0)
    mine = LoRa(spreading_factor=9)
    assert Links(preset="lora_sf12", medium=mine).medium == mine
    links = Links(preset="acoustic", latency={"kind": "propagation", "speed": 1400.0})
    assert (links.latency, links.medium) == (Propagation(speed=1400.0), Links(preset="acoustic").medium)


def test_the_values_of_all_presets_are_golden():
    """Each is stated with its source; a changed value changes the results of all who name the preset."""
    golden("presets.txt", {name: json.dumps(values, indent=1) for name, values in PRESETS.items()})
