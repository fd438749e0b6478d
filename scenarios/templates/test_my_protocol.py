"""The check of MyProtocol: python test_my_protocol.py, or pytest."""

from my_protocol import MyProtocol

from desim.testing import check_protocol


def test_my_protocol_is_right():
    """If you are unsure whether MyProtocol is right, run this: an error says what is wrong with it."""
    check_protocol(MyProtocol)


if __name__ == "__main__":
    test_my_protocol_is_right()
    print("MyProtocol passes check_protocol")
