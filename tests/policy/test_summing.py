"""Constants that join sums: one pass holds for programs that add them at once, and for those that add them last."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from viatool.policy import Activation, Affine, Input, Network
from viatool.policy.activations import activation
from viatool.policy.identity import is_same
from viatool.policy.summing import with_constants_in_sums, without_other_orders
from viatool.taylor.deviation import runtime_deviation

N = 40
GENERATOR = np.random.default_rng(0)
FIRST, LAST = (GENERATOR.normal(size=shape).astype(np.float32).astype(float) for shape in ((N, N), (2, N)))
SHIFT, END = (30.0 * GENERATOR.normal(size=size).astype(np.float32).astype(float) for size in (N, 2))


def apart() -> list[Any]:
    """Products with matrices, and additions after them, as exporters write them."""
    return [
        Input(N),
        Affine((0,), (FIRST,), np.zeros(N)),
        Affine((1,), (np.eye(N),), SHIFT),
        Activation(2, activation("Relu"), N),
        Affine((3,), (LAST,), np.zeros(2)),
        Affine((4,), (np.eye(2),), END),
    ]


def joined() -> Network:
    nodes = Input(N), Affine((0,), (FIRST,), SHIFT), Activation(1, activation("Relu"), N)
    return Network((*nodes, Affine((2,), (LAST,), END)))


def test_a_program_that_adds_constants_last_sums_in_one_of_the_orders_of_the_one_that_joins_them() -> None:
    single, whole = Network(tuple(apart())), joined()
    assert is_same(with_constants_in_sums(single), whole)
    assert without_other_orders((single, whole)) == (whole,)
    assert without_other_orders((whole, single)) == (whole,)
    assert without_other_orders((single,)) == (single,)
    assert without_other_orders((single, Network(tuple(apart())))) != ()
    assert with_constants_in_sums(whole) is whole


def changed(index: int, **given: Any) -> Callable[[], list[Any]]:
    def make() -> list[Any]:
        nodes = apart()
        nodes[index] = replace(nodes[index], **given)
        return nodes

    return make


def read_twice() -> list[Any]:
    nodes = apart()
    nodes[4] = Affine((3, 1), (LAST, LAST), np.zeros(2))
    return nodes


APART = {
    "a sum with a constant of its own": changed(1, bias=np.ones(N)),
    "another precision": changed(2, precision="float64"),
    "a scale": changed(2, weights=(2.0 * np.eye(N),)),
    "roundings": changed(2, roundings=1),
    "merged constants": changed(2, merged_bias=np.abs(SHIFT)),
    "roundings of the sum": changed(1, roundings=1),
    "a sum that something else reads": read_twice,
}


@pytest.mark.parametrize("nodes", APART.values(), ids=APART)
def test_what_is_rounded_otherwise_is_not_joined(nodes: Callable[[], list[Any]]) -> None:
    kept = with_constants_in_sums(Network(tuple(nodes())))
    assert len(kept.nodes) == 5  # the end alone
    assert len(without_other_orders((Network(tuple(nodes())), joined()))) == 2


def test_what_is_allowed_for_the_joined_sum_holds_for_a_float32_program_that_adds_constants_last() -> None:
    points = GENERATOR.uniform(-3.0, 3.0, (200, N)).astype(np.float32)
    exact = joined().values(points.astype(float))
    first, last = FIRST.astype(np.float32), LAST.astype(np.float32)
    hidden = np.float32(0) * points
    for term in range(N):
        hidden = hidden + points[:, term, None] * first[:, term]
    hidden = np.maximum(hidden + SHIFT.astype(np.float32), np.float32(0))
    actions = np.zeros((200, 2), np.float32)
    for term in range(N):
        actions = actions + hidden[:, term, None] * last[:, term]
    strayed = np.abs((actions + END.astype(np.float32)).astype(float) - exact[-1])
    allowed = runtime_deviation(joined(), [(value, value) for value in exact])
    assert (strayed <= allowed).all()
    assert strayed.max() > 0.0
