"""Up to which number a network tells its inputs apart: never less than the program does."""

from __future__ import annotations

import numpy as np
import pytest

from viatool.policy import Activation, Affine, Input, Network
from viatool.policy.activations import activation
from viatool.policy.told_apart import ceilings

CLIP = activation("Clip", max=1.5)


def affine(source, *rows, bias=0.0):
    weight = np.array(rows, dtype=float)
    return Affine((source,), (weight,), np.full(len(weight), bias))


def clipped(*more, join=((1, 0), (0, 1))):
    """A network of two inputs, the first clipped, and put together with the second."""
    parts = np.array(join, dtype=float)
    return Network(
        (
            Input(2),
            affine(0, [1, 0]),
            Activation(1, CLIP, 1),
            Affine((2, 0), (parts[:, :1], np.array([[0, 0], [0, 1.0]])), np.zeros(2)),
            *more,
        )
    )


def test_an_input_that_is_clipped_before_anything_else_is_told_apart_up_to_there():
    assert ceilings(clipped(affine(3, [2.0, 3.0]))).tolist() == [1.5, np.inf]


@pytest.mark.parametrize(
    "network",
    [
        clipped(affine(0, [1.0, 0.0])),  # passed by another way
        clipped(Affine((3, 0), (np.eye(2), np.eye(2)), np.zeros(2))),
        Network((Input(1), affine(0, [1.0]))),  # given as it is
        Network((Input(1), affine(0, [2.0]), Activation(1, CLIP, 1))),  # what rounding does is not counted
        Network((Input(1), affine(0, [1.0], bias=0.5), Activation(1, CLIP, 1))),
        Network((Input(1), Activation(0, activation("Relu"), 1))),
        Network((Input(1), Activation(0, activation("Clip", min=0.0), 1))),
    ],
)
def test_an_input_that_is_taken_otherwise_has_no_ceiling(network):
    assert ceilings(network)[0] == np.inf


def test_of_several_clips_the_highest_counts():
    network = Network(
        (
            Input(1),
            Activation(0, CLIP, 1),
            Activation(0, activation("Clip", max=3.0), 1),
            Affine((1, 2), (np.eye(1), np.eye(1)), np.zeros(1)),
        )
    )
    assert ceilings(network).tolist() == [3.0]
    far = np.array([[3.0], [7.0], [1e6]])
    assert (network(far) == network(far[:1])).all()
