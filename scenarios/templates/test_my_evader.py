"""The check of MyEvader: python test_my_evader.py, or pytest."""

from my_evader import MyEvader

from desim.testing import check_evader


def test_my_evader_is_right():
    """If you are unsure whether MyEvader is right, run this: an error says what is wrong with it."""
    check_evader(MyEvader)


if __name__ == "__main__":
    test_my_evader_is_right()
    print("MyEvader passes check_evader")
