"""Error counters of a line: an error share since the last check that exceeds its limit."""

from palmd.devices.health import SERIAL_PAD_LIMITS, ErrorShare, ErrorShares, bytes_since, last_report
from palmd.devices.versapad import PACKET_BYTES, VersaPadDecoder, encode_packet


def test_the_share_must_be_exceeded_among_enough_bytes():
    assert not ErrorShare(0.1, 20).exceeded(19, 19)  # too few for a verdict
    assert not ErrorShare(0.1, 20).exceeded(20, 2)  # exactly the limit
    assert ErrorShare(0.1, 20).exceeded(20, 3)


def test_only_bytes_since_the_last_check_count():
    share = ErrorShare(0.1, 20)
    assert share.exceeded(100, 50)
    assert not share.exceeded(200, 52)  # 2 of the last 100; earlier errors do not count
    assert share.text("packets") == "2 of 100 packets since the last check"
    assert not share.exceeded(200, 52)  # nothing new
    assert share.exceeded(220, 72)


def test_ages_and_byte_counts_are_formatted():
    assert last_report(None, 1.0) == "no packet has come yet"
    assert last_report(1.0, 1.25) == "its last packet is 250 ms old"
    assert last_report(1.0, 2.0) == "its last packet is 1.0 s old"
    assert bytes_since(0) == "not a byte has come since"
    assert bytes_since(3) == "3 bytes have come since, which are no packet"


def test_conditions_hold_until_the_next_check_and_state_their_counts():
    shares = ErrorShares({"garbled": (0.2, 24, "bytes"), "batched": (0.5, 10, "packets")})
    assert list(shares) == []
    shares.update({"garbled": (100, 21), "batched": (9, 9)})
    assert list(shares) == ["garbled"] == list(shares)
    assert shares.text("garbled") == "21 of 100 bytes since the last check"
    assert shares.text("silent") == ""
    shares.update({"garbled": (200, 21), "batched": (20, 15)})
    assert list(shares) == ["batched"]
    assert shares.text("batched") == "6 of 11 packets since the last check"


def test_a_packet_cut_by_opening_the_port_is_no_damage():
    """Found by a simulated run: a restarted daemon whose first check came 25 ms later."""
    packet = encode_packet(10, 20, 40)
    for cut in range(1, PACKET_BYTES):
        for whole in range(40):
            decoder, shares = VersaPadDecoder(9600), ErrorShares(SERIAL_PAD_LIMITS)
            decoder.feed(packet[cut:] + whole * packet, 0.0)
            counters = decoder.counters
            assert counters.discarded == PACKET_BYTES - cut
            counted = dict.fromkeys(SERIAL_PAD_LIMITS, (0, 0)) | {"garbled": (counters.bytes, counters.discarded)}
            shares.update(counted)
            assert list(shares) == []
