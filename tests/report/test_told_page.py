"""The page that is made of JSON alone: the gate first, with what fails it."""

from __future__ import annotations

from collections.abc import Callable

from viatool.report.gate import Gate, evaluate, parse_threshold
from viatool.report.states.document import StatesDocument
from viatool.report.told_page import told_page


def test_the_gate_stands_before_the_percentage(document: Callable[..., StatesDocument]) -> None:
    state = {"state": 7, "scenario": "lab-4", "time": 6.7, "pose": [1.0, 2.0, 0.5]}
    report = document(97, 1, 2, unsafe_states=[state])
    page = told_page(report, evaluate(Gate((parse_threshold("1", StatesDocument),)), report))
    gate = page.index('<h2 class="gate failed">Gate failed</h2>')
    assert (
        gate
        < page.index("State 7 is unsafe: scenario lab-4")
        < page.index("97.00 % of the states are proved safe")
    )
    assert 'class="gate' not in told_page(report, ()).split("</style>")[1]
