"""The setting of a verification as plain data, as far as somebody needs it who rechecks its verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import onnx

from viatool.policy import Policy, load_policy
from viatool.policy.action_map import scaling_of
from viatool.policy.command_map import Chosen, Picked
from viatool.policy.entries import SUFFIX
from viatool.samples import POLICIES
from viatool.verification.rules_document import rules_document

if TYPE_CHECKING:
    from viatool.report.evidence.inputs import InputFile
    from viatool.setting.setting import Setting
    from viatool.verification.result import Result


def describe_setting(
    result: Result, specification: Path | None, inputs: Sequence[InputFile], scenarios: str
) -> dict[str, Any]:
    """Return rules, errors, program and inputs as plain data; `scenarios` is the digest of what was driven."""
    setting = result.setting
    policy = load_policy(result.policy_path, specification, self_check=False)
    model = _model(policy)
    commands, reason = (
        (None, "the file does not give what is bounded") if model is None else _commands(setting, policy)
    )
    return {
        "schema_version": 1,
        "rules": rules_document(result.rules),
        "pose_radii": setting.pose_radii.tolist(),
        "moving": setting.moves,
        "is_box": is_box(setting),
        "channels": [
            {
                "name": channel.name,
                "columns": setting.inputs.columns(channel.name).tolist(),
                "encoded": bool(channel.encoding),
            }
            for channel in setting.inputs.channels
        ],
        "model": model,
        "commands": commands,
        "commands_are": reason,
        "inputs": [one.to_json() for one in inputs],
        "scenarios": scenarios,
    }


def is_box(setting: Setting) -> bool:
    """Tell whether every observation of the stated box is admitted, so that bounds hold for all of it."""
    return setting.reading_errors.is_box and not setting.believes


def _model(policy: Policy) -> dict[str, Any] | None:
    """Return how the file is run: its inputs, one after another the observation, and which output counts."""
    (output, *_) = policy.runtime.outputs
    entries = None
    if policy.spec is not None and output.endswith(SUFFIX):
        entries = [action.entry for action in policy.spec.action]
        output = output.removesuffix(SUFFIX)
    graph = onnx.load(POLICIES.find(policy.path), load_external_data=False).graph
    given = [value.name for value in graph.output]
    if output not in given:
        return None
    inputs = [{"name": port.name, "shape": list(port.shape)} for port in policy.ports.each]
    return {
        "inputs": inputs,
        "output": output,
        "entries": entries,
        "precision": policy.ports.precision,
        "alone": given == [output],
    }


def _commands(setting: Setting, policy: Policy) -> tuple[dict[str, Any] | None, str]:
    """Return what makes commands of the outputs; None, and what it is in words, where that is more than numbers."""
    mapped = setting.command_map
    numbers = mapped.numbers if isinstance(mapped, Chosen) else mapped
    if setting.overrides:
        return None, "rules are wrapped around the policy"
    if not isinstance(numbers, Picked):
        return None, f"they are computed from {' and '.join(mapped.kinds)}"
    scaling = scaling_of(policy.spec)
    whole = [1.0] * mapped.actions, [0.0] * mapped.actions
    return {
        "columns": list(numbers.columns),
        "scale": whole[0] if scaling is None else scaling.scale.tolist(),
        "offset": whole[1] if scaling is None else scaling.offset.tolist(),
        "limits": None
        if scaling is None or scaling.limits is None
        else [list(ends) for ends in scaling.limits],
        "choice": mapped.commands.tolist() if isinstance(mapped, Chosen) else None,
    }, ""
