"""What is trained: the methods and alphas that are compared, and the settings in which they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from viatool.studies.study import Options
from viatool.studies.tasks import Task


@dataclass(frozen=True)
class Variant:
    """One row of the tables: a method, for VIA with its alpha.

    Parameters
    ----------
    name, title : str
        In paths and in tables.
    method : str
        Of the trainer.
    family : str
        "unconstrained", "expectation" or "cvar": how the constraint sees the cost.
    alpha : float
        CVaR level.
    """

    name: str
    title: str
    method: str
    family: str
    alpha: float = 0.9


@dataclass(frozen=True)
class TrainingSetting:
    """Where and under which limit everything is trained.

    Parameters
    ----------
    name, title : str
        In paths and in pages.
    settings : tuple of str
        ``key=value`` over the preset of every training.
    base : TrainingSetting, optional
        One that differs in the limit alone: what is trained without a constraint is the same there.
    """

    name: str
    title: str
    settings: tuple[str, ...]
    base: TrainingSetting | None = None

    def home(self, variant: Variant) -> TrainingSetting:
        """Return the setting whose training of a variant counts here."""
        return self.base if self.base is not None and variant.family == "unconstrained" else self


TD3 = Variant("td3", "TD3", "td3", "unconstrained")
TD7 = Variant("td7", "TD7", "td7", "unconstrained")
SAC_LAG = Variant("sac-lag", "SAC-Lagrangian", "sac-lag", "expectation")
RCPO = Variant("rcpo", "RCPO", "rcpo", "expectation")
WCSAC = Variant("wcsac", "WCSAC", "wcsac", "cvar")
CVAR_CPO = Variant("cvar-cpo", "CVaR-CPO", "cvar-cpo", "cvar")
VIA_LOW = Variant("via-0.1", "VIA 0.1", "via", "cvar", 0.1)
VIA_MIDDLE = Variant("via-0.5", "VIA 0.5", "via", "cvar", 0.5)
VIA = Variant("via-0.9", "VIA 0.9", "via", "cvar", 0.9)

METHODS = (TD3, TD7, SAC_LAG, RCPO, WCSAC, CVAR_CPO, VIA)
"""The rows of the paper's Table I."""

ALPHAS = (VIA_LOW, VIA_MIDDLE, VIA)
"""The columns of the paper's alpha study."""

EVERY = (*METHODS[:-1], *ALPHAS)
VARIANTS = {variant.name: variant for variant in EVERY}

LAB = TrainingSetting("lab", "the paper's lab, b = 10", ("map=lab", "cost_limit=10"))
MEAN_LIMIT = TrainingSetting("mean-limit", "the lab, b = 0.5", ("map=lab", "cost_limit=0.5"), LAB)
SETTINGS = {setting.name: setting for setting in (LAB, MEAN_LIMIT)}


def plan(setting: TrainingSetting, variants: Sequence[Variant], options: Options) -> list[Task]:
    """Return the trainings of some variants in a setting, each followed by the evaluations of its seeds."""
    from viatool.studies.training import EvaluateSeed, TrainVariant

    tasks: list[Task] = []
    for variant in variants:
        training = TrainVariant.of(setting.home(variant), variant, options)
        tasks.append(training)
        tasks += [
            EvaluateSeed(training, seed, options.scenarios, options.eps, options.footprint)
            for seed in range(options.seeds)
        ]
    return tasks
