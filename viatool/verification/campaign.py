"""All states of a run through an examination: cut into chunks, carried out by a scheduler, kept in a checkpoint."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from viatool.schedule import Checkpoint, Piece, Scheduler, Span, cut, digest_of
from viatool.verification.examination import Examination
from viatool.verification.findings import Findings
from viatool.verification.states import States

_CHUNKS_PER_WORKER = 8
_MOST_BLOCKS = 8
_MOST_FLOATS = 2**20  # 8 MB, below which Dask does not complain of large messages


@dataclass(frozen=True)
class Campaign:
    """How the states of a run are worked through.

    Parameters
    ----------
    scheduler : Scheduler
        Who does the work.
    checkpoint : path, optional
        Folder that keeps what is finished.
    resume : bool
        Whether to continue from it.
    chunk : int, optional
        States that a worker gets at once, rounded up to whole blocks; by default as many as keep all workers
        busy to the end in little memory.
    """

    scheduler: Scheduler
    checkpoint: str | os.PathLike[str] | None = None
    resume: bool = False
    chunk: int | None = None

    def carry_out(
        self,
        examination: Examination,
        states: States,
        versions: Mapping[str, str],
        tell: Callable[[int, int], None],
    ) -> Findings:
        """Examine all states.

        Parameters
        ----------
        examination : Examination
            What happens to each block.
        states : States
            N states.
        versions : mapping
            Of everything that may change a result.
        tell : callable
            Called with the states done and the states in all.

        Returns
        -------
        Findings
            Of N states: the same, bit for bit, for every scheduler, chunk and interruption.
        """
        store = None
        if self.checkpoint is not None:
            run = describe(examination, states, versions)
            store = Checkpoint(self.checkpoint, run, resume=self.resume)
        found = {} if store is None else {span: Findings.from_arrays(part) for span, part in store.finished()}
        done = sum(len(part.contested.danger) for part in found.values())
        if done:
            tell(done, len(states))
        spans = cut(states.block_count, found, self._blocks_at_once(states))
        for piece, part in self.scheduler.run(examination, _pieces(states, spans)):
            if store is not None:
                store.write(piece.span, part.to_arrays(), piece.name)
            found[piece.span] = part
            done += len(piece.content)
            tell(done, len(states))
        return Findings.join([found[span] for span in sorted(found)])

    def _blocks_at_once(self, states: States) -> int:
        if self.chunk is not None:
            return max(1, -(-self.chunk // states.block_size))
        light = _MOST_FLOATS // (states.block_size * int(states.observations.shape[1]))
        fair = states.block_count // (_CHUNKS_PER_WORKER * self.scheduler.workers)
        return max(1, min(light, fair, _MOST_BLOCKS))


def _pieces(states: States, spans: Iterable[Span]) -> Iterator[Piece[States]]:
    """Cut the pieces out of the states, each when it is asked for."""
    for span in spans:
        content = states.blocks(span)
        name = f"states {content.first:,} to {content.first + len(content) - 1:,}"
        yield Piece(span, name, content)


def describe(examination: Examination, states: States, versions: Mapping[str, str]) -> dict[str, Any]:
    """Return everything that the findings depend on, as plain data for the manifest of a checkpoint."""
    policy, setting = examination.policy, examination.setting
    world_map = setting.world_map
    surroundings = (world_map.arena, world_map.obstacles)
    meaning = setting.spec.model_dump_json()
    rules = json.loads(json.dumps(asdict(setting.rules), default=lambda array: array.tolist()))
    return {
        "policy": policy.sha256,
        "network": digest_of((policy.network, meaning)),
        "map": digest_of(surroundings),
        "states": digest_of(states),
        **rules,
        "radii": setting.radii.tolist(),
        "engine": dict(examination.engine),
        "only contested": examination.only_contested,
        "seed": examination.seed,
        "horizon": None if examination.outlook is None else asdict(examination.outlook.horizon),
        "block": states.block_size,
        **{f"version of {name}": text for name, text in versions.items()},
    }
