"""Annotations are executed while tests run: what does not fit them is an error."""

import numpy as np
import pytest
from jaxtyping import Float64, TypeCheckError

from filtering.se3 import Poses
from tests.helpers.checks import checked, every_call_checked, no_checks
from vapor.benchmark.recordings.storage import from_rows
from vapor.evaluation.consistency import longest_s

WRONG = {
    "fields of a dataclass": lambda: Poses(np.eye(3), np.zeros(4)),
    "fields of one size": lambda: Poses(np.stack([np.eye(3)] * 2), np.zeros((3, 3))),
    "shape": lambda: from_rows(np.zeros((2, 13))),
    "type of numbers": lambda: from_rows(np.zeros((2, 12), np.float32)),
    "arguments of one size": lambda: longest_s(np.zeros(2, bool), np.zeros((2, 1), np.int64)),
    "no array, and a class that is defined later": lambda: Poses.identity() @ np.eye(4),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_arguments_that_do_not_fit_are_refused(wrong):
    with every_call_checked(), pytest.raises(TypeCheckError, match="parameter"):
        wrong()


@checked
def first_of_each(pairs: Float64[np.ndarray, "n 2"], count: int) -> Float64[np.ndarray, " n"]:
    return pairs[:count, 0]


def test_a_result_that_does_not_fit_is_refused_but_where_nothing_is_checked():
    assert len(first_of_each(np.zeros((3, 2)), 3)) == 3
    with pytest.raises(TypeCheckError, match="return"):
        first_of_each(np.zeros((3, 2)), 2)
    with no_checks():
        assert len(first_of_each(np.zeros((3, 2)), 2)) == 2
