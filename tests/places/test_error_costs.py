"""What errors cost a certificate: each number is that of a certification without the error."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from viatool import load_map, load_policy
from viatool.cli import main
from viatool.places import STATUSES, Campaign, Resolution, SearchBudget, campaign, certify, explaining
from viatool.schedule import Deadline, Processes, Serial
from viatool.uncertainty import ErrorModel

ROOM, POLICY = load_map(Path("maps/room.yaml")), load_policy(Path("policies/via.onnx"))
EPS = {"": 0.0, "goal_distance": 0.05}
TERMS = {
    "sensor": {"lidar": {"absolute": 0.02, "relative": 0.0, "bias": 0.08, "missing": 1}},
}
RUN = {"resolution": Resolution(0.1, 0), "budget": SearchBudget(share=0.02), "seed": 3, "delay": 0.1}
EVERY = {
    "sensor": {
        "lidar": {"absolute": 0.01, "relative": 0.01, "bias": 0.01, "angle": 0.01, "missing": 1, "thin": 0.1}
    },
    "pose": {"x": 0.01, "y": 0.01, "theta": 0.01},
    "actuation": {
        "linear": {
            "acceleration": 2.0,
            "deceleration": 2.0,
            "lag": [0.0, 0.05],
            "relative": 0.01,
            "absolute": 0.01,
        },
        "slip": 0.01,
    },
    "timing": {"interval": [0.09, 0.11], "delay": [0.0, 0.02], "sensing": 0.01},
    "obstacles": {"speed": 0.1},
}


def certified(terms=TERMS, eps=EPS, **changed):
    model = ErrorModel.model_validate(terms)
    return certify(POLICY, ROOM, eps=eps, errors=model, **{**RUN, "explain_errors": True, **changed})


def without(section, *names):
    """The terms without one of them."""
    terms = json.loads(json.dumps(TERMS))
    part = terms[section]
    for name in names[:-1]:
        part = part[name]
    del part[names[-1]]
    return terms


@pytest.fixture(scope="module")
def certificate():
    return certified()


def proved_at(found, places):
    """Whether the leaves of another certificate that hold places (N, 5) are proved, (N,)."""
    lower, upper = found.lattice.bounds(found.findings.nodes)
    proved = np.isin(found.findings.status, [STATUSES.index("certified"), STATUSES.index("uncontested")])
    at = [np.flatnonzero(((lower <= place) & (place <= upper)).all(axis=1)) for place in places]
    assert all(len(rows) for rows in at)
    return np.array([proved[rows[0]] for rows in at])


def test_each_error_costs_the_cells_that_a_certification_without_it_proves(certificate):
    found, costs = certificate.findings, certificate.error_costs
    lost = found.status >= STATUSES.index("refuted")
    assert costs.not_proved == lost.sum() == len(costs.rows) > 50
    middles = np.mean(certificate.lattice.bounds(found.nodes.select(costs.rows)), axis=0)
    told = {term.term: term.saved for term in costs.terms}
    for term, terms, eps in (
        ("sensor.lidar.bias", without("sensor", "lidar", "bias"), EPS),
        ("sensor.lidar.missing", without("sensor", "lidar", "missing"), EPS),
        ("delay", TERMS, EPS),
        ("eps of lidar", without("sensor", "lidar", "absolute"), EPS | {"lidar": 0.0}),
    ):
        delay = 0.0 if term == "delay" else 0.1
        other = certified(terms, eps, explain_errors=False, delay=delay)
        saved = proved_at(other, middles)
        number = [one.term for one in costs.terms].index(term)
        assert (costs.proved[:, number] == saved).all(), term
        assert told[term] == saved.sum()
    assert told["sensor.lidar.missing"] > 0
    assert told["delay"] > 0


def test_what_errs_by_nothing_costs_nothing_and_the_costliest_is_first(certificate):
    costs = certificate.error_costs
    saved = [term.saved for term in costs.terms]
    assert saved == sorted(saved, reverse=True)
    assert costs.terms[-1].saved == 0 < saved[0]
    assert {term.term: term.saved for term in costs.terms}["sensor.lidar.relative"] == 0
    assert saved[0] <= costs.together <= len(costs.rows)
    assert (costs.proved.sum(axis=0) == saved).all()


def test_every_term_that_certify_takes_is_dropped_in_turn(monkeypatch):
    monkeypatch.setattr(explaining, "MOST", 12)
    found = certified(EVERY, {"": 0.0}, delay=0.0, budget=SearchBudget(share=0.005)).error_costs
    places = [place for place, *_ in ErrorModel.model_validate(EVERY).stated() if "absolute" not in place]
    dropped = {term.term for term in found.terms}
    left = {told.partition(":")[0] for told in found.left_out}
    assert dropped | left == {"eps of lidar", "actuation.linear.absolute", *places}
    assert left <= {"actuation.linear.acceleration"}
    assert found.proved.shape == (12, len(dropped))


def test_the_certificate_is_the_same_as_without_the_question(certificate):
    plain = certified(explain_errors=False)
    assert plain.units == certificate.units
    assert plain.error_costs is None
    assert "error_costs" not in plain.to_json()
    assert "fails_by" not in plain.cell_table()


def test_cells_and_the_document_say_what_each_fails_by(certificate):
    table, told = certificate.cell_table(), certificate.to_json()["error_costs"]
    for term in told["terms"]:
        named = np.array([term["term"] in one.split(",") for one in table["fails_by"]])
        assert named.sum() == term["cells"]
        assert set(table["status"][named]) <= {"refuted", "unknown"}
        assert term["share"] == term["cells"] / certificate.contested[1]


def test_workers_and_interruptions_answer_the_same(certificate, monkeypatch, tmp_path):
    monkeypatch.setattr(campaign.RootWork, "piece", 2)
    monkeypatch.setattr(explaining.RejudgedCells, "piece", 40)
    for resume in (False, True):
        kept = Campaign(Processes(2) if resume else Serial(), tmp_path / "kept", resume)
        found = certified(campaign=kept)
        assert found.error_costs.terms == certificate.error_costs.terms
        assert found.error_costs.together == certificate.error_costs.together
    parts = list((tmp_path / "kept").glob("explain-*/*.npz"))
    assert len(parts) == -(-certificate.error_costs.not_proved // 40)


def test_when_the_time_is_up_what_was_judged_until_then_is_told(certificate):
    """A clock that stands still through the search, and goes on by seconds afterwards."""
    clock = iter([0.0] * 10_000)
    seconds = [0.0]

    def now():
        if next(clock, None) is None or explaining_now():
            seconds[0] += 4.0
        return seconds[0]

    def explaining_now():
        return began

    began = False

    def tell(stage, done, total):
        nonlocal began
        began = stage == "cells judged again" and done > 0

    budget = SearchBudget(Deadline.after(100.0, now), share=0.02)
    found = certified(budget=budget, tell=tell).error_costs
    assert 0 < len(found.rows) < found.not_proved == certificate.error_costs.not_proved
    assert found.proved.shape[0] == len(found.rows)


def test_the_reports_rank_them(tmp_path):
    (tmp_path / "errors.yaml").write_text("sensor: {lidar: {absolute: 0.02, bias: 0.08}}")
    asked = [
        "certify", "policies/via.onnx", "--map", "maps/room.yaml", "--smallest", "0.1", "--halvings", "0", "--sample",
        "0.05", "--eps", "0", "--errors", str(tmp_path / "errors.yaml"), "--explain-errors", "-o",
        f"json:{tmp_path / 'places.json'}", "-o", f"markdown:{tmp_path / 'places.md'}", "-o",
        f"html:{tmp_path / 'places.html'}",
    ]  # fmt: skip
    run = CliRunner().invoke(main, asked)
    assert run.exit_code == 0, run.output
    for text in (run.output, (tmp_path / "places.md").read_text(), (tmp_path / "places.html").read_text()):
        assert "What the errors cost" in text
        assert "sensor.lidar.bias" in text
        assert "all of them together" in text
    shown = CliRunner().invoke(main, ["report", str(tmp_path / "places.json")])
    assert "of the contested volume" in " ".join(shown.output.split())


def test_the_worst_places_name_the_errors_that_save_their_cells(certificate):
    table, worst = certificate.cell_table(), certificate.to_json()["worst"]
    refuted = np.flatnonzero(table["status"] == "refuted")
    assert worst
    for one in worst:
        (row,) = np.flatnonzero((table["witness_pose"] == one["pose"]).all(axis=1))
        told = str(table["fails_by"][refuted[row]])
        assert one["saved_by"] == [name for name in told.split(",") if name]
        assert (table["lower"][refuted[row], :3] <= np.array(one["pose"]) + 1e-9).all()
        assert one["obstacle"]
