"""The check of my_metric: python test_my_metric.py, or pytest."""

from my_metric import my_metric

from desim.testing import check_metric


def test_my_metric_is_right():
    """If you are unsure whether my_metric is right, run this: an error says what is wrong with it."""
    check_metric(my_metric)


if __name__ == "__main__":
    test_my_metric_is_right()
    print("my_metric passes check_metric")
