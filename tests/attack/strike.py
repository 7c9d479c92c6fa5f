"""One graph attacked: loaded, bounded in several boxes, and driven against its bounds."""

from __future__ import annotations

import re
import tempfile
import traceback
import warnings
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from tests.attack.boxes import draw_boxes, inside, neighbours, sample
from tests.attack.building import Array
from tests.attack.graphs import RandomGraph
from tests.attack.interpreter import EXACT, MP, PRECISE, Interpreter
from tests.attack.program import LEVELS, Program
from viatool.errors import EnclosureError, SelfCheckError, ViatoolError
from viatool.policy import Policy, load_policy
from viatool.taylor import reach

MEMORY = Path("/dev/shm")

SETTINGS: tuple[dict[str, Any], ...] = (
    {"refine": "none"},
    {"refine": "none"},
    {"refine": "split", "most_parts": 30},
    {"refine": "none", "order": 2},
    {"refine": "monotone", "order": 2},
    {"refine": "none", "approximation": "bernstein"},
    {"refine": "monotone", "approximation": "taylor"},
)
"""One of them is drawn for most graphs, beside the engine's defaults; what is attacked is where both bounds overlap."""

_SEARCHED = 560
"""About how many points the climbs of one graph take."""

_GUARD = MP.mpf(10) ** -36
"""Numbers of 240 bits count as outside only by more than this, which they may be off after a cancellation."""


@dataclass(frozen=True)
class Effort:
    """How hard one graph is attacked.

    Parameters
    ----------
    boxes : int
        Drawn for each graph.
    samples : int
        Random points and corners in each box.
    steps : int
        Of each climb, one for every box, action and side.
    exact : int
        Points of each graph that are evaluated exactly or in 240 bits.
    """

    boxes: int = 4
    samples: int = 150
    steps: int = 4
    exact: int = 20

    @classmethod
    def for_points(cls, points: float, exact: float) -> Effort:
        """Return the effort that takes about so many points of each graph."""
        return cls(
            samples=max(20, round((points - _SEARCHED) / cls.boxes)), exact=round(exact) + (exact > 0) * 2
        )


@dataclass
class Finding:
    """What must not happen."""

    kind: str
    """`escape`, `escape (real)`, `no number`, `exception`, `self-check` or `bounds`."""
    detail: str
    excess: float = 0.0


@dataclass
class Outcome:
    """What came of one graph."""

    number: int
    ended: str = "attacked"
    """`attacked`, `refused`, `not run` (by onnxruntime), `undefined` (the program gives no number), `unbounded`."""
    reason: str = ""
    kind: str = ""
    opset: int = 0
    operators: list[str] = field(default_factory=list)
    gated: bool = False
    unchecked: bool = False
    """Whether the self-check told nothing."""
    boxes: int = 0
    unbounded: int = 0
    points: int = 0
    exact: int = 0
    findings: list[Finding] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def strike_in_memory(graph: RandomGraph, effort: Effort) -> Outcome:
    """Attack one graph in a folder that costs no disk where there is one."""
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        return strike(graph, Path(folder), effort)


def strike(graph: RandomGraph, folder: Path, effort: Effort) -> Outcome:
    """Attack one graph; whatever goes wrong is a finding."""
    outcome = Outcome(
        graph.number, kind=graph.kind, opset=graph.opset, operators=graph.operators, gated=bool(graph.gates)
    )
    path = folder / "attacked.onnx"
    path.write_bytes(graph.model.SerializeToString())
    try:
        program = Program(graph)
    except Exception as error:  # onnxruntime raises its own, undocumented classes
        outcome.ended, outcome.reason = "not run", _first_line(error)
        return outcome
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            policy = load_policy(path)
            outcome.unchecked = any("not checked" in str(warning.message) for warning in told)
            Strike(graph, program, policy, effort, outcome).run()
        except SelfCheckError as error:
            if "against nan" in error.message:
                outcome.ended = "undefined"
            else:
                outcome.ended = "refused"
                outcome.findings.append(Finding("self-check", error.message))
        except ViatoolError as error:
            outcome.ended, outcome.reason = "refused", _refusal(error.message)
        except Exception:
            outcome.findings.append(Finding("exception", traceback.format_exc(limit=-6)))
    return outcome


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:160]


def _refusal(message: str) -> str:
    """Return the operator and the reason of the first refused node, without names and numbers."""
    found = re.search(r"\(([\w.]+)\) ([^\n]*)", message)
    text = f"{found[1]}: {found[2]}" if found else message.rpartition(".onnx")[2].splitlines()[0]
    return re.sub(r"-?\d[\d.e+-]*", "N", text)[:90]


class Strike:
    """The bounds of some boxes, and the values that come closest to them.

    Notes
    -----
    The program's own finite differences lead the climbs, so nothing but the bounds comes from the engine.
    """

    def __init__(
        self, graph: RandomGraph, program: Program, policy: Policy, effort: Effort, outcome: Outcome
    ) -> None:
        self.graph, self.program, self.policy, self.effort, self.outcome = (
            graph,
            program,
            policy,
            effort,
            outcome,
        )
        self.rng = np.random.default_rng((graph.seed, graph.number, 1))
        self.centres, self.widths = draw_boxes(graph, effort.boxes, self.rng)
        self.settings: list[dict[str, Any]] = [{}]
        if self.rng.random() < 0.6:
            self.settings.append(SETTINGS[int(self.rng.integers(len(SETTINGS)))])

    def run(self) -> None:
        self.lower, self.upper = self.bound("float32")
        if not self._keep(np.isfinite(self.lower).all(axis=1)):
            self.outcome.ended = "unbounded"
            return
        self.low, self.high = self.centres - self.widths, self.centres + self.widths
        shape = (len(self.centres), self.policy.output_size, 2)  # (B, A, sides)
        self.gaps = np.full(shape, np.inf)
        self.best = np.zeros((*shape, self.program.size))
        points = sample(self.low, self.high, self.effort.samples, self.rng)
        boxes = np.repeat(np.arange(len(points)), points.shape[1])
        self.observe(points.reshape(len(boxes), -1), boxes)
        for step in range(self.effort.steps):
            self.climb(step)
        for _ in range(4):
            self.nudge()
        if self.effort.exact:
            self.attack_exactly()

    def _keep(self, bounded: Array) -> bool:
        self.outcome.boxes, self.outcome.unbounded = int(bounded.sum()), int((~bounded).sum())
        self.centres, self.widths = self.centres[bounded], self.widths[bounded]
        self.lower, self.upper = self.lower[bounded], self.upper[bounded]
        return bool(bounded.any())

    # --- bounds ---

    def bound(self, arithmetic: str) -> tuple[Array, Array]:
        """Return the intersection of the bounds by all settings, (B, A) each; NaN where there are none."""
        shape = (len(self.centres), self.policy.output_size)
        lower, upper = np.full(shape, np.nan), np.full(shape, np.nan)
        for setting in self.settings:
            for rows in self._bounded_rows(arithmetic, setting):
                low, high = rows[1].lower, rows[1].upper
                if not (low <= high).all():
                    self.found("bounds", f"{arithmetic} {setting}: {low} is above {high}")
                lower[rows[0]] = np.fmax(lower[rows[0]], low)
                upper[rows[0]] = np.fmin(upper[rows[0]], high)
        return lower, upper

    def _bounded_rows(self, arithmetic: str, setting: dict[str, Any]) -> list[tuple[Any, Any]]:
        """Bound all boxes at once, one by one where one of them has no finite bounds."""
        everything = slice(None)
        try:
            return [(everything, self._reach(everything, arithmetic, setting))]
        except EnclosureError:
            pass
        found = []
        for box in range(len(self.centres)):
            row = slice(box, box + 1)
            try:
                found.append((row, self._reach(row, arithmetic, setting)))
            except EnclosureError:
                continue
        return found

    def _reach(self, rows: slice, arithmetic: str, setting: dict[str, Any]) -> Any:
        return reach(
            self.policy,
            self.centres[rows],
            self.widths[rows],
            arithmetic=arithmetic,
            **setting,  # type: ignore[arg-type]
        )

    # --- the program ---

    def observe(self, points: Array, boxes: Array) -> Array:
        """Run points (P, n) of boxes (P,) in every way; return what the optimised program gives, (P, A)."""
        self.outcome.points += len(points)
        results = {level: self.program.together(points, level) for level in LEVELS}
        for level, values in results.items():
            self.judge(points, boxes, values, f"{level}, together")
        values = results[LEVELS[0]]
        nearest = np.argsort(np.minimum(self.upper[boxes] - values, values - self.lower[boxes]).min(axis=1))[
            :6
        ]
        for level in LEVELS if self.graph.batched else ():
            alone = self.program.one_by_one(points[nearest], level)
            self.judge(points[nearest], boxes[nearest], alone, f"{level}, alone")
        return values

    def judge(self, points: Array, boxes: Array, values: Array, how: str) -> None:
        """Compare values (P, A) with the bounds of their boxes, and remember the nearest of each side."""
        gaps = np.stack([values - self.lower[boxes], self.upper[boxes] - values], axis=-1)  # (P, A, 2)
        if not (gaps >= 0).all():
            excess = np.where(gaps >= 0, 0.0, np.where(np.isnan(gaps), np.inf, -gaps))
            p, action, side = np.unravel_index(np.argmax(excess), excess.shape)
            kind = "escape" if np.isfinite(values[p, action]) else "no number"
            self.found(
                kind,
                self._describe(points[p], boxes[p], action, f"{float(values[p, action])!r} ({how})"),
                float(excess[p, action, side]),
            )
        gaps = np.where(np.isnan(gaps), np.inf, gaps)
        order = np.lexsort((np.zeros(len(boxes)), boxes))
        for box in np.unique(boxes[order]):
            rows = np.flatnonzero(boxes == box)
            first = gaps[rows].argmin(axis=0)  # (A, 2)
            least = np.take_along_axis(gaps[rows], first[None], axis=0)[0]
            better = least < self.gaps[box]
            self.gaps[box] = np.where(better, least, self.gaps[box])
            self.best[box] = np.where(better[..., None], points[rows][first], self.best[box])

    def _describe(self, point: Array, box: int, action: int, value: str) -> str:
        bounds = f"[{float(self.lower[box, action])!r}, {float(self.upper[box, action])!r}]"
        return (
            f"action {action}: {value} outside of {bounds}\n"
            f"  centre {self.centres[box].tolist()}\n  eps {self.widths[box].tolist()}\n  at {point.tolist()}"
        )

    def found(self, kind: str, detail: str, excess: float = 0.0) -> None:
        """Note a finding; of each kind the worst is kept."""
        known = [finding for finding in self.outcome.findings if finding.kind == kind]
        if known and known[0].excess >= excess:
            return
        self.outcome.findings = [f for f in self.outcome.findings if f.kind != kind]
        self.outcome.findings.append(Finding(kind, detail, excess))

    # --- search ---

    def _climbers(self) -> tuple[Array, Array, Array, Array]:
        """Return the best points (C, n), their boxes (C,), actions (C,) and signs (C,)."""
        boxes, actions, sides = (index.ravel() for index in np.indices(self.gaps.shape))
        return self.best.reshape(len(boxes), -1), boxes, actions, np.where(sides == 1, 1.0, -1.0)

    def climb(self, step: int) -> None:
        """Move every best point towards the corner that the program's finite differences name."""
        points, boxes, actions, signs = self._climbers()
        low, high = self.low[boxes], self.high[boxes]
        width = high - low
        reach_of_step = np.maximum(
            width * 10.0 ** -self.rng.integers(1, 5), 1e-7 * np.abs(points) * (width > 0)
        )
        forward = np.where(points + reach_of_step <= high, reach_of_step, -reach_of_step)
        size = points.shape[1]
        moved = np.repeat(points[:, None], size + 1, axis=1)  # (C, n + 1, n)
        moved[:, np.arange(size), np.arange(size)] += forward
        moved = inside(moved, low[:, None], high[:, None])
        values = self.observe(moved.reshape(-1, size), np.repeat(boxes, size + 1))
        values = values.reshape(len(points), size + 1, -1)
        own = (
            np.take_along_axis(values, actions[:, None, None], axis=2)[..., 0] * signs[:, None]
        )  # (C, n + 1)
        with np.errstate(all="ignore"):
            slope = (own[:, :size] - own[:, size:]) * np.sign(forward)
        corner = np.where(slope > 0, high, np.where(slope < 0, low, points))
        share = 1.0 if step % 2 == 0 else self.rng.uniform(0.1, 0.9, (len(points), 1))
        self.observe(inside(points + share * (corner - points), low, high), boxes)
        self.observe(inside(corner, low, high), boxes)

    def nudge(self) -> None:
        """Look at neighbours of every best point in the last place."""
        points, boxes, _, _ = self._climbers()
        self.observe(neighbours(points, self.low[boxes], self.high[boxes], self.graph.kind, self.rng), boxes)

    # --- the exact network ---

    def attack_exactly(self) -> None:
        """Evaluate the points that came closest, and corners, without rounding."""
        interpreter = Interpreter(self.graph.model)
        arithmetic = EXACT if interpreter.is_rational else PRECISE
        self.settings = self.settings[-1:] if self.rng.random() < 0.5 else self.settings[:1]
        lower, upper = self.bound("real")
        points, boxes, _, _ = self._climbers()
        corners = sample(self.low, self.high, 4, self.rng)[:, 1:]
        points = np.concatenate([points, corners.reshape(-1, points.shape[1])])
        boxes = np.concatenate([boxes, np.repeat(np.arange(len(corners)), corners.shape[1])])
        for k in self.rng.permutation(len(points))[: self.effort.exact]:
            box = boxes[k]
            if not np.isfinite(lower[box]).all():
                continue
            try:
                values = interpreter(points[k].reshape(self.graph.shape), arithmetic)
            except (ZeroDivisionError, ValueError, OverflowError, TypeError):
                continue  # undefined there
            self.outcome.exact += 1
            for action, value in enumerate(values):
                excess = max(_above(value, upper[box, action]), _above(-value, -lower[box, action]))
                if excess > 0:
                    detail = f"{float(value)!r} in real arithmetic"
                    self.lower, self.upper = lower, upper
                    self.found("escape (real)", self._describe(points[k], box, action, detail), excess)


def _above(value: Any, bound: float) -> float:
    """Return how far a value is certainly above a bound; 0 if it is not."""
    if isinstance(value, Fraction):
        gap = value - Fraction(bound)
        return max(float(gap), 5e-324) if gap > 0 else 0.0
    gap = MP.mpf(value) - MP.mpf(bound)
    return max(float(gap), 5e-324) if gap > _GUARD else 0.0
