"""All states of a run through an examination, as work for the driver of long work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from numpy.typing import NDArray

from viatool.schedule import Span, Work, digest_of
from viatool.verification.examination import StateExamination
from viatool.verification.findings import Arrays, StateFindings
from viatool.verification.states import States

_CHUNKS_PER_WORKER = 8
_MOST_BLOCKS = 8
_MOST_FLOATS = 2**20  # 8 MB, below which Dask does not complain of large messages


@dataclass(frozen=True, eq=False)
class StateWork(Work[States, StateFindings]):
    """The examination of states; a unit is a block of them.

    Parameters
    ----------
    examination : StateExamination
        What happens to each block.
    states : States
        N states.
    versions : mapping
        Of everything that may change a result.
    """

    examination: StateExamination
    states: States
    versions: Mapping[str, str]
    stage = "states"

    def __len__(self) -> int:
        """Return the number of blocks."""
        return self.states.block_count

    @property
    def function(self) -> StateExamination:
        """Return what happens to each block."""
        return self.examination

    def content(self, span: Span) -> States:
        """Return the states of some blocks."""
        return self.states.blocks(span)

    def size(self, span: Span) -> int:
        """Return the number of states in some blocks."""
        return min(span.last * self.states.block_size, len(self.states)) - span.first * self.states.block_size

    def name(self, span: Span) -> str:
        """Return which states some blocks are."""
        first = self.states.first + span.first * self.states.block_size
        return f"states {first:,} to {first + self.size(span) - 1:,}"

    def at_once(self, workers: int) -> int:
        """Return as many blocks as keep all workers busy to the end in little memory."""
        states = self.states
        light = _MOST_FLOATS // (states.block_size * int(states.observations.shape[1]))
        fair = states.block_count // (_CHUNKS_PER_WORKER * workers)
        return max(1, min(light, fair, _MOST_BLOCKS))

    def describe(self) -> dict[str, Any]:
        """Return everything that the findings depend on."""
        return describe(self.examination, self.states, self.versions)

    def to_arrays(self, part: StateFindings) -> Arrays:
        """Return findings as arrays."""
        return part.to_arrays()

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> StateFindings:
        """Return findings."""
        return StateFindings.from_arrays(arrays)

    def join(self, parts: Sequence[StateFindings]) -> StateFindings:
        """Return the findings of consecutive blocks as one."""
        return StateFindings.join(parts)


class CloseWork(StateWork):
    """The examination of close places."""

    stage = "close places"


def describe(examination: StateExamination, states: States, versions: Mapping[str, str]) -> dict[str, Any]:
    """Return everything that the findings depend on, as plain data for the manifest of a checkpoint."""
    policy, setting = examination.policy, examination.setting
    world_map = setting.world_map
    surroundings = (world_map.arena, world_map.obstacles)
    meaning = setting.spec.model_dump_json()
    rules = setting.rules.to_json()
    return {
        "policy": policy.sha256,
        "network": digest_of((policy.network, policy.rewritten, meaning)),
        "map": digest_of(surroundings),
        "states": digest_of(states),
        **rules,
        "radii": setting.radii.tolist(),
        "errors": setting.uncertainty.exactly(),
        "efforts": [dict(effort) for effort in examination.efforts],
        "bounded every": examination.bounded_every,
        "only contested": examination.only_contested,
        "seed": examination.seed,
        "horizon": None if examination.horizon is None else asdict(examination.horizon.horizon),
        "block": states.block_size,
        **{f"version of {name}": text for name, text in versions.items()},
    }
