"""A small certificate, the same with hostile names, and how it is rendered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.hall import write_policy
from tests.renamed import renamed
from viatool import load_map, load_policy
from viatool.places import Certificate, Resolution, certify
from viatool.report import Check
from viatool.report.outputs import Output, content_of
from viatool.report.places.run import PlacesRun

HOSTILE = "</script><img src=x onerror=owned=1>\"'`{{1}}|**b**\r\n::error::x\x1b[31m%0A=1]]>&amp; $x$ <!--"
FAILED = Check("certified share of the contested volume >= 100.00 %", passed=False, figures="50.00 %")


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Certificate:
    """Return the room, driven by the policy of the hall, in large cells."""
    policy = load_policy(write_policy(tmp_path_factory.mktemp("certified") / "policy.onnx"))
    room = load_map(Path("maps/room.yaml"))
    return certify(policy, room, room.scenarios[0], eps=0.01, resolution=Resolution(0.2, 0), seed=1)


@pytest.fixture(scope="session")
def hostile(certificate: Certificate) -> Certificate:
    """Return a certificate in which everything that others name bears one name."""
    return replace(
        certificate,
        policy=replace(certificate.policy, path=Path(HOSTILE)),
        scenario=replace(certificate.scenario, name=HOSTILE),
        setting=renamed(certificate.setting, HOSTILE),
        versions={**certificate.versions, HOSTILE: HOSTILE},
    )


@pytest.fixture
def render(monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Render a certificate in a format of text."""
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)

    def render(certificate: Certificate, name: str, *checks: Check) -> str:
        return b"".join(content_of(Output(name, Path("-")), PlacesRun(certificate), checks)).decode()

    return render
