"""What is done with each operator of the ONNX standard, as a table for the documentation."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from viatool.policy.folding import FOLDED
from viatool.policy.fused import fused_operators
from viatool.policy.operators.registry import Entry, entry_of, registered
from viatool.policy.refusals import FAMILIES

Verdict = Literal["exact", "enclosed", "folded", "refused"]

_HEAD = """\
# Operators

<!-- Written by `python -m viatool.policy.operators.table`, checked by tests/policy/test_standard.py. -->

Every operator of the ONNX standard is treated in exactly one of four ways:

- **exact**: linear in its computed input, or a selection of its elements. It becomes weights, and its bounds lose
  nothing but rounding.
- **enclosed**: it bends. The engine replaces it by a polynomial with a guaranteed error.
- **folded**: read where it does not depend on the observation (it is evaluated once, in the element types of the
  model); refused where it does.
- **refused**: by name, with every other unsupported node of the graph, before anything is computed.

An operator is read in the opset versions that are listed in brackets and in no other: a newer version is refused until
its meaning is known. All of them are compared with onnxruntime in the tests, and every loaded policy again before its
first verdict.
"""

_NOTES = """\
## How the float32 contract reads a graph

- Each operator of the graph is one step of the network, so its rounding is counted where the program rounds.
  Moving elements about is exact.
- Division by a constant, batch normalisation and means carry the extra roundings of the program on each term.
- A variance may be computed in two passes, in one (the mean of squares less the squared mean, which cancels) or by
  updates, in any order; also where a graph spells it out. Statistics are taken in the precision of `stash_type`.
- Activations that exporters write as several operators (`x * Sigmoid(x)`, `x * (1 + Erf(x / 1.4142135))`,
  `Where(x > 20, x, Softplus(x))`, ...) are recognised where they are equal to one function in real arithmetic.
- A logistic from its parts (`1 / (1 + Exp(-x))`, with `Div`, `Reciprocal` or `Pow`, and `x / (1 + Exp(-b * x))`)
  keeps to its range also where its exponential overflows, which makes the quotient 0. So do `Exp(x) / (1 + Exp(x))`,
  tanh from two exponentials and a softmax from its parts (`Exp(z) / ReduceSum(Exp(z))`,
  `z - Log(ReduceSum(Exp(z)))`); they are refused by name where the program gives NaN: where an exponential may
  overflow, or all may vanish, unless `z` is `x - ReduceMax(x)`.
- What is divided by its own root mean square (`LayerNormalization`, `x / Sqrt(ReduceMean(x * x) + e)`, ...) is at most
  the square root of how many values there are, whatever the box.
- `Softmax` and `LogSoftmax` are functions of the log-odds of each value, which keep to their range for logits up to
  magnitudes of 1e100.
- Terms that are added up when a graph is read count as large as they were before they cancelled: `x + 1e6 - 1e6` loses
  the digits of x in the program, and its bounds say so.
- A constant that the graph computes from others is kept as the real number that it stands for, and carries how many
  roundings a runtime may be off; the layer that uses it counts them.
- `GRU`, `LSTM` and `RNN` over the steps of one observation are unrolled: each gate is an affine node and an activation,
  with the error of the runtime's own gates. Their number of steps is fixed, and all are used.
- `Loop` and `Scan` are unrolled, and of an `If` one branch is read, where constants decide how often and which.
- A Clip keeps every finite limit: the largest float32 number limits a double.
"""


def treatment_of(operator: str, version: int | None = None) -> Verdict:
    """Return how an operator of the default domain is treated, in one version or in the newest that is read."""
    known = [number for name, number in registered() if name == operator]
    entry = entry_of(operator, max(known, default=0) if version is None else version)
    if entry is not None:
        return entry.treatment
    return "folded" if operator in FOLDED else "refused"


def operator_table() -> str:
    """Return docs/operators.md."""
    entries = {entry.operator: entry for entry in registered().values()}
    conditions = [entry for entry in entries.values() if entry.treatment == "folded"]
    compared = ", ".join(f"`{entry.operator}`" for entry in sorted(conditions, key=lambda e: e.operator))
    own = ", ".join(f"`{name}`" for name in fused_operators() if name != "LayerNormalization")
    folded = ", ".join(f"`{name}`" for name in sorted(FOLDED - entries.keys()))
    refused = [
        f"- {', '.join(f'`{name}`' for name in chosen)}: {reason}; {hint}."
        for reason, hint, names in FAMILIES
        if (chosen := sorted(name for name in names if treatment_of(name) == "refused"))
    ]
    return "\n".join(
        [
            _HEAD,
            *_read(entries.values(), "exact"),
            *_read(entries.values(), "enclosed"),
            "## Folded",
            "",
            f"{folded}.",
            "",
            f"{compared}: also {conditions[0].note}.",
            "",
            "## Refused",
            "",
            *refused,
            "- every other operator, and every operator of another domain that is not among the next.",
            "",
            "## onnxruntime's own",
            "",
            "What its optimiser joins is read as the operators of the standard for which it stands, also in a file "
            f"that it wrote: {own}. Its LayerNormalization in opsets before 17 is one of them.",
            "",
            _NOTES.rstrip(),
            "",
        ]
    )


def _read(entries: Iterable[Entry], treatment: Verdict) -> list[str]:
    """Return the section of the operators of a treatment: those without limits, then each of the others."""
    chosen = sorted((e for e in entries if e.treatment == treatment), key=lambda entry: entry.operator)
    free = ", ".join(_named(entry) for entry in chosen if not entry.note)
    limited = [f"- {_named(entry)}: {entry.note}." for entry in chosen if entry.note]
    return [f"## {treatment.capitalize()}", "", f"{free}.", "", *limited, ""]


def _named(entry: Entry) -> str:
    versions = sorted(v for (name, v) in registered() if name == entry.operator)
    return f"`{entry.operator}` ({', '.join(map(str, versions))})"


if __name__ == "__main__":
    import sys

    import viatool.policy.operators

    assert viatool.policy.operators.registered()
    sys.stdout.write(operator_table())
