"""Queries for other verifiers, in VNN-LIB: whether a network leaves the bounds that are stated for it.

The input box and the bounds are written as the exact decimals of their float64 numbers, so that the query is about the
same sets as the bound. VNN-LIB knows no strict comparison: the query asks for an output that is the next float64
outside of the bounds, or farther. It speaks of the exact network; bounds for float32 hold for that one as well.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.policy.action_map import scaling_of
from viatool.report.files import Content

if TYPE_CHECKING:
    from viatool.policy import Policy

_SECONDS = 300  # that an instance asks a verifier to take at most


def query(observation: tuple[Floats, Floats], output: tuple[Floats, Floats], about: str) -> str:
    """Return the query that some input of a box leads to an output outside of bounds.

    Parameters
    ----------
    observation : tuple of ndarray
        (n,) ends of the inputs.
    output : tuple of ndarray
        (A,) bounds of the outputs.
    about : str
        One line that says what the query is of.

    Returns
    -------
    str
        ``unsat`` confirms the bounds, ``sat`` is an input that leaves them.

    Raises
    ------
    ConfigurationError
        If a number is not finite.

    Notes
    -----
    Sound: yes. The box is the same as the one of the bounds, to the last digit.
    """
    (low, high), (least, most) = observation, output
    if not all(np.isfinite(end).all() for end in (low, high, least, most)):
        raise ConfigurationError(
            f"{about}: a bound is not finite, so there is no query", "choose a state with finite bounds"
        )
    below, above = np.nextafter(least, -np.inf), np.nextafter(most, np.inf)
    lines = [f"; {about}", "; unsat confirms the bounds, sat is an input that leaves them", ""]
    lines += [f"(declare-const X_{index} Real)" for index in range(len(low))]
    lines += [f"(declare-const Y_{index} Real)" for index in range(len(least))]
    lines.append("")
    for index, ends in enumerate(zip(low, high, strict=True)):
        lines += [
            f"(assert ({sign} X_{index} {decimal(end)}))"
            for sign, end in zip((">=", "<="), ends, strict=True)
        ]
    lines += ["", "(assert (or"]
    for index, ends in enumerate(zip(below, above, strict=True)):
        lines += [
            f"    (and ({sign} Y_{index} {decimal(end)}))"
            for sign, end in zip(("<=", ">="), ends, strict=True)
        ]
    return "\n".join([*lines, "))", ""])


def decimal(number: float) -> str:
    """Write a float64 number as a decimal without an exponent, exactly."""
    return f"{Decimal(float(number)):f}"


def instances(model: str, queries: Sequence[str]) -> str:
    """Return the table by which verifiers are given queries: model, query and seconds."""
    table = io.StringIO()
    csv.writer(table, lineterminator="\n").writerows([model, one, _SECONDS] for one in queries)
    return table.getvalue()


def query_folder(
    policy: Policy, observations: Floats, radii: Floats, bounds: tuple[Floats, Floats]
) -> Mapping[str, Content]:
    """Return the files of a folder with the model, and a query for each of B observations.

    Parameters
    ----------
    policy : Policy
        Whose outputs are bounded as they are, see `require_plain`.
    observations, radii : ndarray
        (B, n) centres and half-widths of the boxes, whose ends are rounded outward.
    bounds : tuple of ndarray
        (B, A) ends of the outputs.
    """
    low, high = (
        np.where(radii > 0.0, np.nextafter(observations + side * radii, side * np.inf), observations)
        for side in (-1.0, 1.0)
    )
    queries = {
        f"row-{row}.vnnlib": query(ends[:2], ends[2:], f"the outputs around observation {row}")
        for row, ends in enumerate(zip(low, high, *bounds, strict=True))
    }
    return {
        "policy.onnx": policy.runtime.content,
        **queries,
        "instances.csv": instances("policy.onnx", list(queries)),
    }


def require_plain(policy: Policy) -> None:
    """Refuse a policy whose bounds are not those of the outputs of one model with one input.

    Raises
    ------
    ConfigurationError
        Names what stands between the model and what is bounded.
    """
    reasons = {
        "it has several inputs": len(policy.ports.each) > 1,
        "it chooses among commands": policy.spec is not None and policy.spec.choice is not None,
        "its specification scales or clips the outputs": scaling_of(policy.spec) is not None,
    }
    for reason, holds in reasons.items():
        if holds:
            raise ConfigurationError(
                f"a VNN-LIB query cannot be asked of '{policy.path}': {reason}",
                "write the bounds to a file (npz, csv), or export the policy with everything inside the model",
            )
