"""The paper's numbers (Tables I and II): mean and standard deviation over its five seeds; shares in per cent."""

from __future__ import annotations

Numbers = dict[str, tuple[float, float]]

_COLUMNS = (
    "fixed_success",
    "fixed_collision",
    "fixed_cost",
    "fixed_success_safety",
    "fixed_collision_safety",
    "fixed_safety",
)


def _row(*numbers: tuple[float, float] | None) -> Numbers:
    return {name: pair for name, pair in zip(_COLUMNS, numbers, strict=True) if pair is not None}


PAPER: dict[str, Numbers] = {
    "td3": _row((76.7, 4.7), (15.0, 7.6), None, (98.9, 1.3), (85.2, 5.3), (98.4, 0.8)),
    "td7": _row((78.0, 7.5), (12.0, 7.5), None, (97.3, 0.3), (84.7, 3.2), (95.1, 1.0)),
    "sac-lag": _row((64.0, 4.9), (36.0, 4.9), (3.52, 6.42), (97.4, 2.4), (86.4, 4.8), (94.3, 2.5)),
    "rcpo": _row((90.0, 8.9), (4.0, 4.9), (1.17, 1.46), (98.5, 0.3), (91.7, 0.2), (97.4, 0.3)),
    "wcsac": _row((88.0, 7.5), (12.0, 7.5), (1.79, 4.29), (97.5, 0.7), (88.1, 4.4), (95.6, 1.7)),
    "cvar-cpo": _row((76.0, 4.9), (24.0, 4.9), (3.22, 3.16), (96.5, 1.9), (87.2, 2.7), (94.1, 1.5)),
    "via-0.1": _row((86.0, 4.9), (12.0, 4.0), None, (99.5, 0.8), (87.3, 5.0), (98.7, 0.5)),
    "via-0.5": _row((90.0, 0.0), (10.0, 0.0), None, (99.6, 0.1), (92.1, 0.6), (97.6, 0.4)),
    "via-0.9": _row((98.3, 4.9), (1.7, 4.9), (1.52, 1.53), (99.6, 0.6), (94.4, 0.2), (99.1, 0.6))
    | {"width_v": (0.019, 0.003), "width_omega": (0.087, 0.018)},
}
"""By variant and metric. The paper evaluates on its ten fixed scenarios and verifies the states visited there, by the
sampled criterion; nothing of it was measured on held-out scenarios."""
