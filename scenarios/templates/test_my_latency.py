"""The check of MyLatency: python test_my_latency.py, or pytest."""

from my_latency import MyLatency

from desim.testing import check_latency


def test_my_latency_is_right():
    """If you are unsure whether MyLatency is right, run this: an error says what is wrong with it."""
    check_latency(MyLatency)


if __name__ == "__main__":
    test_my_latency_is_right()
    print("MyLatency passes check_latency")
