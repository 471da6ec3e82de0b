"""Who stays in the cast."""

import numpy as np

from export.cast.coverage import covers, improve, set_cover


def test_a_case_is_covered_within_the_factor_and_without_more_losses():
    cost = np.array([[1.0, 4.0], [1.2, 2.0], [1.4, 2.1]])
    lost = np.array([[0, 0], [0, 0], [0, 1]])
    covered = covers(cost, lost, specialist=np.array([0, 1]), within=1.3)
    np.testing.assert_array_equal(covered, [[True, False], [True, True], [False, False]])


def test_set_cover_takes_the_widest_first_and_keeps_what_is_given():
    covered = np.array([[1, 0, 0, 0, 0], [0, 1, 1, 0, 0], [0, 0, 1, 1, 0], [0, 1, 1, 1, 0]], dtype=bool)
    assert set_cover(covered, [0]) == [0, 3]  # the last case is covered by nobody
    assert set_cover(covered, [0, 1]) == [0, 1, 2]


def test_improve_adds_whoever_lowers_the_cost_and_ends():
    cost = np.array([[1.0, 10.0, 10.0], [10.0, 1.0, 10.0], [10.0, 10.0, 9.99], [1.0, 0.99, 10.0]])
    assert improve(cost, [0], most=4, least_gain=0.01) == [0, 3]
    assert improve(cost, [0], most=1, least_gain=0.0001) == [0]
    assert improve(cost, [0], most=4, least_gain=0.0001) == [0, 3, 2]
