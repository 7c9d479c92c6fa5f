"""Training navigation policies: VIA on a TD3 backbone, many seeds side by side, export of the best."""

from __future__ import annotations

from viatool.train.configuration import PRESETS, TrainingConfiguration, load_configuration, make_configuration
from viatool.train.export import export_checkpoint
from viatool.train.progress import Progress, Silence, console_progress
from viatool.train.trainer import TrainingResult, resume, train

__all__ = [
    "PRESETS",
    "Progress",
    "Silence",
    "TrainingConfiguration",
    "TrainingResult",
    "console_progress",
    "export_checkpoint",
    "load_configuration",
    "make_configuration",
    "resume",
    "train",
]
