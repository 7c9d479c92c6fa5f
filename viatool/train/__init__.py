"""Training navigation policies: VIA on a TD3 backbone, many seeds side by side, export of the best."""

from __future__ import annotations

from viatool.schedule import Progress
from viatool.train.batches import complete, failing_scenarios, holds_progress, resume_seeds, train_seeds
from viatool.train.configuration import TrainingConfiguration, load_configuration, make_configuration
from viatool.train.export import export_checkpoint
from viatool.train.maps import TrainingMaps
from viatool.train.presets import PRESETS
from viatool.train.trainer import TrainingResult, resume, train

__all__ = [
    "PRESETS",
    "Progress",
    "TrainingConfiguration",
    "TrainingMaps",
    "TrainingResult",
    "complete",
    "export_checkpoint",
    "failing_scenarios",
    "holds_progress",
    "load_configuration",
    "make_configuration",
    "resume",
    "resume_seeds",
    "train",
    "train_seeds",
]
