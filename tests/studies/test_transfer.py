"""The transfer study: every place is driven and verified, and the page says that it is simulation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from viatool.studies import STUDIES, study_named
from viatool.studies.study import Options, write_data, write_page
from viatool.studies.tasks import Record, execute
from viatool.studies.transfer import DriveAndVerify


class Silent:
    """Progress that nobody looks at."""

    def __init__(self) -> None:
        self.fractions: list[float] = []

    def __call__(self, stage: str, done: float, total: float, line: str = "", /) -> None:
        self.fractions.append(done / total)


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Record]:
    folder = tmp_path_factory.mktemp("transfer")
    tasks = study_named("transfer").plan(replace(Options(), scenarios=2))
    chosen = [task for task in tasks if task.name.endswith(("kinematic", "rough"))]
    return {task.name: execute(task, folder, Silent()) for task in chosen}


def test_it_has_the_places_of_the_paper_and_between() -> None:
    assert "transfer" in STUDIES
    tasks = study_named("transfer").plan(Options())
    assert [task.place.robot for task in tasks if isinstance(task, DriveAndVerify)] == [
        "turtlebot3",
        "turtlebot3",
        "jackal",
        "jackal",
    ]
    assert len({json.dumps(task.parameters()) for task in tasks}) == 4


def test_every_place_is_verified_on_its_own_states(records: dict[str, Record]) -> None:
    states = []
    for record in records.values():
        task, verified = record.result["task"], record.result["verified"]
        assert sum(task[name]["count"] for name in ("success", "collision", "timeout")) == 2
        assert verified["states"] == verified["safety_rate"]["overall"]["total"] > 20
        assert 0.0 < verified["reachable_width"]["v"]["mean"] < 0.1
        states.append(verified["states"])
    assert states[0] != states[1]


def test_the_page_shows_the_paper_beside_it_and_says_what_it_is(
    records: dict[str, Record], tmp_path: Path
) -> None:
    study, options = study_named("transfer"), replace(Options(), scenarios=2)
    write_data(study, options, study.plan(options), records, tmp_path)
    text = write_page(study, tmp_path).read_text(encoding="utf-8")
    assert "**All of this is simulation.**" in text
    success = next(line for line in text.splitlines() if line.startswith("| Success rate"))
    cells = [cell.strip() for cell in success.strip("|").split("|")]
    assert cells[-2:] == ["98.3 ± 4.9", "90.0 ± 6.3"]
    assert len(cells) == 5  # two places are there so far
